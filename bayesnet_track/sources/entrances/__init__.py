"""What every entrance of data has in common: notices of what is not used, and which boxes can be used."""
