"""Real spherical harmonics to degree 3, and their gradient by direction: text for native snippets.

They take ``count`` (1, 4, 9, 16) and a unit direction ``x, y, z``, of whatever type ``number`` is.
"""

from dwgs.splat.constants import SH_C0, SH_C1, SH_C2, SH_C3

C0, C1 = f"{SH_C0}f", f"{SH_C1}f"
C20, C21, C22 = (f"{c}f" for c in SH_C2)
C30, C31, C32, C33, C34 = (f"{c}f" for c in SH_C3)

SH_BASIS = f"""
    auto sh_basis = [&](number x, number y, number z, number* basis) -> void {{  // the first ``count``
        basis[0] = zero + {C0};
        if (count > 1) {{
            basis[1] = -{C1} * y;
            basis[2] = {C1} * z;
            basis[3] = -{C1} * x;
        }}
        if (count > 4) {{
            basis[4] = {C20} * x * y;
            basis[5] = -{C20} * y * z;
            basis[6] = {C21} * (2.0f * z * z - x * x - y * y);
            basis[7] = -{C20} * x * z;
            basis[8] = {C22} * (x * x - y * y);
        }}
        if (count > 9) {{
            basis[9] = -{C30} * y * (3.0f * x * x - y * y);
            basis[10] = {C31} * x * y * z;
            basis[11] = -{C32} * y * (4.0f * z * z - x * x - y * y);
            basis[12] = {C33} * z * (2.0f * z * z - 3.0f * x * x - 3.0f * y * y);
            basis[13] = -{C32} * x * (4.0f * z * z - x * x - y * y);
            basis[14] = {C34} * z * (x * x - y * y);
            basis[15] = -{C30} * x * (x * x - 3.0f * y * y);
        }}
    }};
"""

SH_BASIS_ADJOINT = f"""
    // gradient by the direction, from those by the first ``count`` harmonics
    auto sh_basis_adjoint = [&](number x, number y, number z, const number* v, number* v_direction) -> void {{
        number v_x = zero, v_y = zero, v_z = zero;
        if (count > 1) {{
            v_x -= {C1} * v[3];
            v_y -= {C1} * v[1];
            v_z += {C1} * v[2];
        }}
        if (count > 4) {{
            v_x += {C20} * (v[4] * y - v[7] * z) - 2.0f * {C21} * v[6] * x + 2.0f * {C22} * v[8] * x;
            v_y += {C20} * (v[4] * x - v[5] * z) - 2.0f * {C21} * v[6] * y - 2.0f * {C22} * v[8] * y;
            v_z += 4.0f * {C21} * v[6] * z - {C20} * (v[5] * y + v[7] * x);
        }}
        if (count > 9) {{
            const number s = 4.0f * z * z - x * x - y * y, d = x * x - y * y;
            v_x -= 6.0f * {C30} * v[9] * x * y + 3.0f * {C30} * v[15] * d;
            v_y -= 3.0f * {C30} * v[9] * d - 6.0f * {C30} * v[15] * x * y;
            v_x += {C31} * v[10] * y * z;
            v_y += {C31} * v[10] * x * z;
            v_z += {C31} * v[10] * x * y;
            v_x += {C32} * (2.0f * v[11] * x * y - v[13] * (s - 2.0f * x * x));
            v_y += {C32} * (2.0f * v[13] * x * y - v[11] * (s - 2.0f * y * y));
            v_z -= 8.0f * {C32} * z * (v[11] * y + v[13] * x);
            v_x += z * x * (2.0f * {C34} * v[14] - 6.0f * {C33} * v[12]);
            v_y -= z * y * (2.0f * {C34} * v[14] + 6.0f * {C33} * v[12]);
            v_z += {C33} * v[12] * (6.0f * z * z - 3.0f * x * x - 3.0f * y * y) + {C34} * v[14] * d;
        }}
        v_direction[0] = v_x;
        v_direction[1] = v_y;
        v_direction[2] = v_z;
    }};
"""
