"""Plain-loop oracle of the reference model, written straight from model.md.

Source: sections 2 (torque motor), 3 (pilot stage, feedback, spool), 4 (static balances) and 5 (reference valve).
Plain floats and `math` only, nothing from valvesim. Ideal signed square roots, no end stops, no friction.
SI units; temperatures in degC. State: [theta, theta_dot, p1, p2, x_v, v].
"""

import math

MU_0 = 4e-7 * math.pi

# Section 5, the reference valve at 20 degC.
REFERENCE = {
    # lengths of the magnetic circuit [m]
    "L1": 7.05e-3,
    "L2": 7.29e-3,
    "L3": 8.62e-3,
    "L4": 8.85e-3,
    "L5": 2.83e-3,
    "L6": 10.24e-3,
    "L7": 4.22e-3,
    # thermal expansion [1/degC]
    "a_m": 11e-6,
    "a_c": 9.2e-6,
    "a_x": 9.2e-6,
    "a_f": 12.14e-6,
    "a_s": 17.6e-6,
    "a_p": 11e-6,
    # magnets and magnetic circuit
    "gamma": 0.30,
    "M_0i": 2980.0,
    "M_0T": -0.596,
    "A_gi": 10e-6,
    "R_0i": 1.76e8,
    "N_c": 4780.0,
    # arms [m], stiffnesses [N m/rad, N/m], armature [kg m2, N m s/rad]
    "a_i": 14.5e-3,
    "r": 8.9e-3,
    "b": 13.3e-3,
    "K_si": 10.18,
    "K_fi": 2780.0,
    "J": 1.78e-7,
    "B_a": 1.24e-3,
    # nozzles, fixed orifices, flapper gap [m]
    "d_ni": 0.30e-3,
    "d_0i": 0.20e-3,
    "x_f0i": 0.035e-3,
    "l_n": 0.3e-3,
    "l_0": 0.3e-3,
    "l_x": 0.6e-3,
    # spool [m2, m, m, kg, N s/m] and chambers [m3]
    "A_v": 16.8e-6,
    "w": 12.1e-3,
    "stroke": 0.42e-3,
    "m": 4e-3,
    "B_v": 1.0,
    "V_1": 0.1e-6,
    "V_2": 0.1e-6,
    # pressures [Pa], rated current [A]
    "p_s": 21e6,
    "p_0": 0.5e6,
    "p_L0": 0.0,
    "i_rated": 10e-3,
}


def coefficients(T_m, T_s, T_f, T_n, T_o, valve=REFERENCE):
    """The valve's figures plus every temperature dependent coefficient of sections 2 and 3."""
    c = dict(valve)
    dT_m, dT_s, dT_f, dT_n = T_m - 20.0, T_s - 20.0, T_f - 20.0, T_n - 20.0
    a_m, a_c, a_x, a_s, a_f, a_p = c["a_m"], c["a_c"], c["a_x"], c["a_s"], c["a_f"], c["a_p"]
    L1, L2, L3, L5, L6, L7 = c["L1"], c["L2"], c["L3"], c["L5"], c["L6"], c["L7"]

    # section 2
    c["l_g1"] = (
        L5 * (1 + a_c * dT_m)
        + L6 * (1 + a_m * dT_m)
        - L7 * (1 + a_c * dT_m)
        - L2 * (1 + a_s * dT_s)
        - (L3 - L2) * (1 + a_x * dT_m)
    )
    c["l_g2"] = L2 * (1 + a_s * dT_s) - L1 * (1 + a_c * dT_m)
    c["A_g"] = c["A_gi"] * (1 + 2 * a_c * dT_m)
    c["a"] = c["a_i"] * (1 + a_c * dT_m)
    c["M_0"] = c["M_0i"] + c["M_0T"] * dT_m
    c["R_0"] = c["R_0i"] * (1 + a_m * dT_m) / (1 + 2 * a_m * dT_m)

    # section 3
    c["d_n"] = c["d_ni"] - 2 * c["l_n"] * a_p * dT_n
    c["d_0"] = c["d_0i"] - 2 * c["l_0"] * a_p * dT_n
    c["x_f0"] = c["x_f0i"] - a_p * c["l_x"] * dT_n
    c["C_df"] = 0.663 - 0.00136 * math.exp(-0.1473 * T_o)
    c["C_d0"] = 0.752 - 0.1143 * math.exp(-0.03569 * T_o)
    c["K_s"] = c["K_si"] * (1 - 22 * a_s * dT_s)
    c["K_f"] = c["K_fi"] * (1 - 24 * a_f * dT_f)
    c["A_N"] = math.pi * c["d_n"] ** 2 / 4
    return c


def solve(matrix, right):
    """Gaussian elimination with partial pivoting."""
    n = len(right)
    A = [list(matrix[i]) + [right[i]] for i in range(n)]
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(A[i][k]) > abs(A[pivot][k]):
                pivot = i
        A[k], A[pivot] = A[pivot], A[k]
        for i in range(k + 1, n):
            factor = A[i][k] / A[k][k]
            for j in range(k, n + 1):
                A[i][j] -= factor * A[k][j]
    x = [0.0] * n
    for k in range(n - 1, -1, -1):
        total = A[k][n]
        for j in range(k + 1, n):
            total -= A[k][j] * x[j]
        x[k] = total / A[k][k]
    return x


def torque(theta, current, c):
    """T_d from the nine linear equations of the magnetic circuit (section 2)."""
    a, gamma, M0, R0 = c["a"], c["gamma"], c["M_0"], c["R_0"]
    mu0Ag = MU_0 * c["A_g"]
    N = c["N_c"] * current
    R1 = (c["l_g1"] - a * theta) / mu0Ag
    R2 = (c["l_g1"] + a * theta) / mu0Ag
    R3 = (c["l_g2"] - a * theta) / mu0Ag
    R4 = (c["l_g2"] + a * theta) / mu0Ag
    g = gamma
    matrix = [
        # phi1 phi2 phi3 phi4 phi5 phi6 phi7 phi8 phi_a
        [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, -g, 0.0, 0.0],  # phi1 + phi5 = gamma phi7
        [0.0, 1.0, 0.0, 0.0, -1.0, 0.0, 0.0, -g, 0.0],  # phi2 - phi5 = gamma phi8
        [0.0, 0.0, 1.0, 0.0, 0.0, -1.0, 0.0, -g, 0.0],  # phi3 - phi6 = gamma phi8
        [1.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, -1.0],  # phi1 - phi4 = phi_a
        [0.0, -1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0],  # phi3 - phi2 = phi_a
        [R1, 0.0, 0.0, R4, 0.0, 0.0, R0, 0.0, 0.0],  # R1 phi1 + R4 phi4 + R0 phi7 = M0
        [0.0, R2, R3, 0.0, 0.0, 0.0, 0.0, R0, 0.0],  # R2 phi2 + R3 phi3 + R0 phi8 = M0
        [R1, -R2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],  # R1 phi1 - R2 phi2 = N
        [0.0, 0.0, R3, -R4, 0.0, 0.0, 0.0, 0.0, 0.0],  # R3 phi3 - R4 phi4 = N
    ]
    right = [0.0, 0.0, 0.0, 0.0, 0.0, M0, M0, N, N]
    phi1, phi2, phi3, phi4 = solve(matrix, right)[:4]
    return a / (2 * mu0Ag) * (phi1**2 + phi3**2 - phi2**2 - phi4**2)


def torque_closed_form(theta, current, c):
    """T_d from the closed form at the end of section 2."""
    a, gamma, M0, l_g1, l_g2 = c["a"], c["gamma"], c["M_0"], c["l_g1"], c["l_g2"]
    mu0Ag = MU_0 * c["A_g"]
    N = c["N_c"] * current
    S = l_g1 + l_g2
    X = gamma * S + mu0Ag * c["R_0"]
    b0 = 2 * mu0Ag * M0 * N * a * gamma * l_g1 * l_g2 * S * X
    b1 = mu0Ag * a**2 * gamma * S * (N**2 * S * X + 4 * M0**2 * gamma * l_g1 * l_g2)
    b2 = 2 * mu0Ag * M0 * N * a**3 * gamma**2 * S**2
    a0 = 2 * l_g1**2 * l_g2**2 * X**2
    a2 = -4 * a**2 * gamma * l_g1 * l_g2 * S * X
    a4 = 2 * a**4 * gamma**2 * S**2
    return (b0 + b1 * theta + b2 * theta**2) / (a0 + a2 * theta**2 + a4 * theta**4)


def signed_sqrt(x):
    return math.copysign(math.sqrt(abs(x)), x)


def derivatives(
    state,
    current,
    c,
    density,
    bulk_modulus_1,
    bulk_modulus_2,
    supply_pressure=21e6,
    return_pressure=0.5e6,
    torque_law=torque,
):
    """Time derivatives of the six states (section 3)."""
    theta, theta_dot, p1, p2, x_v, v = state
    p_s, p_0 = supply_pressure, return_pressure
    r, K_f, A_v = c["r"], c["K_f"], c["A_v"]
    rb = r + c["b"]
    x_f = r * theta
    K_fp = 0.43 * c["w"] * (p_s - c["p_L0"])
    area_0 = math.pi * c["d_0"] ** 2 / 4

    q_01 = area_0 * c["C_d0"] * signed_sqrt(2 * (p_s - p1) / density)
    q_02 = area_0 * c["C_d0"] * signed_sqrt(2 * (p_s - p2) / density)
    q_n1 = math.pi * c["d_n"] * (c["x_f0"] - x_f) * c["C_df"] * signed_sqrt(2 * (p1 - p_0) / density)
    q_n2 = math.pi * c["d_n"] * (c["x_f0"] + x_f) * c["C_df"] * signed_sqrt(2 * (p2 - p_0) / density)

    rod = K_f * (rb * theta + x_v)
    jet = 8 * math.pi * r**2 * c["C_df"] ** 2 * c["x_f0"] * p_s * theta
    moment = (
        torque_law(theta, current, c)
        - c["B_a"] * theta_dot
        - c["K_s"] * theta
        - rb * rod
        - r * c["A_N"] * (p1 - p2)
        + jet
    )
    force = A_v * (p1 - p2) - rod - K_fp * x_v - c["B_v"] * v
    return [
        theta_dot,
        moment / c["J"],
        bulk_modulus_1 / c["V_1"] * (q_01 - q_n1 - A_v * v),
        bulk_modulus_2 / c["V_2"] * (q_02 - q_n2 + A_v * v),
        v,
        force / c["m"],
    ]


def static(current, c, supply_pressure=21e6, return_pressure=0.5e6, torque_law=torque):
    """The static point (section 4): p1, p2 and x_v eliminated, the armature's balance bisected in theta.

    The root is the first one met from theta = 0, looking to the side the coil's torque pushes to.
    """
    p_s, p_0 = supply_pressure, return_pressure
    r, K_f, A_v = c["r"], c["K_f"], c["A_v"]
    rb = r + c["b"]
    K_fp = 0.43 * c["w"] * (p_s - c["p_L0"])

    def pressure(gap):
        # q_0 = q_n squared: (orifice)^2 (p_s - p) = (nozzle)^2 (p - p_0)
        orifice = (math.pi * c["d_0"] ** 2 / 4 * c["C_d0"]) ** 2
        nozzle = (math.pi * c["d_n"] * gap * c["C_df"]) ** 2
        return (orifice * p_s + nozzle * p_0) / (orifice + nozzle)

    def point(theta):
        p1 = pressure(c["x_f0"] - r * theta)
        p2 = pressure(c["x_f0"] + r * theta)
        x_v = (A_v * (p1 - p2) - K_f * rb * theta) / (K_f + K_fp)
        return p1, p2, x_v

    def residual(theta, i):
        p1, p2, x_v = point(theta)
        return (
            torque_law(theta, i, c)
            - c["K_s"] * theta
            - rb * K_f * (rb * theta + x_v)
            - r * c["A_N"] * (p1 - p2)
            + 8 * math.pi * r**2 * c["C_df"] ** 2 * c["x_f0"] * p_s * theta
        )

    theta = 0.0
    if current != 0.0:
        step = math.copysign(c["x_f0"] / r / 1000, current)
        if residual(step, 0.0) * step >= 0.0:
            raise ValueError("the armature is unstable at zero current")
        inner, outer = 0.0, step
        while residual(outer, current) * step > 0.0:
            inner, outer = outer, outer + step
            if abs(outer) >= c["x_f0"] / r:
                raise ValueError("no static point inside |theta| < x_f0/r")
        theta = (inner + outer) / 2
        while theta != inner and theta != outer:
            if residual(theta, current) * step > 0.0:
                inner = theta
            else:
                outer = theta
            theta = (inner + outer) / 2
    p1, p2, x_v = point(theta)
    return {"theta": theta, "x_v": x_v, "p1": p1, "p2": p2}


def simulate_rk4(
    state0,
    current_function,
    c,
    density,
    beta1,
    beta2,
    t_end,
    steps,
    supply_pressure=21e6,
    return_pressure=0.5e6,
    torque_law=torque,
):
    """The state at t_end by the classical Runge-Kutta method with `steps` equal steps."""

    def f(t, y):
        return derivatives(
            y, current_function(t), c, density, beta1, beta2, supply_pressure, return_pressure, torque_law
        )

    h = t_end / steps
    y = list(state0)
    for n in range(steps):
        t = n * h
        k1 = f(t, y)
        k2 = f(t + h / 2, [y[j] + h / 2 * k1[j] for j in range(6)])
        k3 = f(t + h / 2, [y[j] + h / 2 * k2[j] for j in range(6)])
        k4 = f(t + h, [y[j] + h * k3[j] for j in range(6)])
        y = [y[j] + h / 6 * (k1[j] + 2 * k2[j] + 2 * k3[j] + k4[j]) for j in range(6)]
    return y
