"""The bundle as a contract: its manifest, its graph files, and the parity report that it carries."""
