"""CALLBACKS: what happens around training steps; they join phases with evaluation."""
