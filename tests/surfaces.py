"""Functions that several test files mesh."""

# Convex here, a saddle there (R. Franke, "Scattered data interpolation", 1982).
FRANKE = (
    "0.75*exp(-((9*x-2)**2+(9*y-2)**2)/4)+0.75*exp(-(9*x+1)**2/49-(9*y+1)/10)"
    "+0.5*exp(-((9*x-7)**2+(9*y-3)**2)/4)-0.2*exp(-(9*x-4)**2-(9*y-7)**2)"
)
