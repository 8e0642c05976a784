"""Colour to grey: arrays in, arrays out; opens no file."""
