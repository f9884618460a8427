"""Surfaces from dense matching within the carved volume."""
