"""What labels mean: classes, their names, ids and mobility; and which class a label of a file or a stream is."""
