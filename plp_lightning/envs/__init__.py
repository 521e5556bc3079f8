"""Simulators: many episodes behind one small interface."""
