"""Modes and events of discontinuous laws, dry friction, rigid stops and contacts."""
