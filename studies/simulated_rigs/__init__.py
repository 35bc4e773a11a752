"""Simulated rigs of many kinds with a law that their model lacks."""
