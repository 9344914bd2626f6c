"""The `ear` command: thin, one file of arguments and one a command that has something to say."""
