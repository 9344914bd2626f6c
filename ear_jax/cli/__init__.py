"""The `ear` command: one module per subcommand, which parses arguments, calls the library and prints."""
