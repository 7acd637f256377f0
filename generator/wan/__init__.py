"""The paper's generator: Wan2.1-VACE, frozen, steered by a PointAdapter. Needs the extra ``wan``, and weights."""
