"""Rules by which agents switch themselves, one file each."""
