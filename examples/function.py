"""A function: few triangles for exp(5x) sin(5y), and how near they come to the fewest possible."""

import equimesh

result = equimesh.remesh("exp(5*x) * sin(5*y)", tol=0.5, domain=(0, 0, 1, 1))
profile = result.profile
print(f"{len(result.triangles)} triangles; the fewest possible are about {result.lower_bound:.0f}")
print(f"the error is {profile.max:.4f} at most, certified below {profile.bound:.4f}")
