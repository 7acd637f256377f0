"""Pictures of backgrounds with vehicles in them, through OpenGL; never torch, never Warp."""
