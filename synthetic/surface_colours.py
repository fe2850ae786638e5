"""Surface colours of objects: BGR, 0..255, before lighting."""

SurfaceColour = tuple[float, float, float]

TYRE: SurfaceColour = (34, 33, 32)
RIM: SurfaceColour = (150, 148, 146)
GLASS: SurfaceColour = (72, 58, 46)
DARK: SurfaceColour = (48, 46, 45)
HEADLIGHT: SurfaceColour = (205, 240, 250)
TAIL_LIGHT: SurfaceColour = (40, 30, 190)
PLATE: SurfaceColour = (225, 228, 228)
SKIN: SurfaceColour = (140, 170, 215)
ORANGE: SurfaceColour = (20, 105, 245)
WHITE: SurfaceColour = (238, 238, 240)
RED: SurfaceColour = (40, 35, 205)
YELLOW: SurfaceColour = (25, 180, 240)
BARK: SurfaceColour = (55, 72, 92)

# The meshes sample from these by index, so another order would change every drive.
BODYWORK: tuple[SurfaceColour, ...] = (
    (236, 236, 234), (190, 188, 184), (120, 116, 112), (45, 42, 40), (45, 40, 165), (150, 85, 35), (90, 60, 30),
    (85, 110, 60), (150, 185, 200), (35, 120, 200),
)  # fmt: skip
CLOTHES: tuple[SurfaceColour, ...] = (
    (60, 45, 40), (130, 70, 45), (50, 50, 150), (170, 160, 150), (60, 110, 60), (50, 160, 200), (110, 60, 110),
    (215, 212, 208), (150, 120, 60),
)  # fmt: skip
PLASTER: tuple[SurfaceColour, ...] = (
    (150, 175, 195), (110, 130, 170), (175, 185, 190), (95, 105, 140), (160, 165, 165), (130, 160, 190), (85, 95, 120),
)  # fmt: skip
