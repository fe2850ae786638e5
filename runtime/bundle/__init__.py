"""The bundle format, the contract between export and runtime: manifest, graph file checks and parity report."""
