"""What sensors add to the physics: noise, ripple, and the counts of an encoder."""
