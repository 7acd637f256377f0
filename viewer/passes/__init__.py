"""The passes of one picture: project, composite, sky."""
