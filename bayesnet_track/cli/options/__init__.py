"""Parsers of single commands, one file each: argparse only, so that `--help` stays quick."""
