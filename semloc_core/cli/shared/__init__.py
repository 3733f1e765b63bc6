"""What the commands share: options, maps and models by name, what is said on the screen."""
