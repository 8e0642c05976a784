"""Convert colour to grey: arrays in, arrays out; open no file."""
