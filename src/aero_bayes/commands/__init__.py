"""One function a command, and fleets: many rigs of one model, on whatever workers the user brings."""
