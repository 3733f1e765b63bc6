"""What is measured and how it is shown: retrieval and classification, honesty, intervals; rows and tables of them."""
