"""The wire contract: DBC files, their codec, end-to-end protection and units."""
