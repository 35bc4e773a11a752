"""What a model may lack and where: ports found in it, laws of libraries, and both written into its source."""
