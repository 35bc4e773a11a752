"""From command-line options to run directories: what each command does, in order."""
