"""`python -m bayesnet_track` is the command `bayesnet-track`."""

from bayesnet_track.cli.main import main

if __name__ == "__main__":
    raise SystemExit(main())
