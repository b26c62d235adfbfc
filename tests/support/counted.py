"""A C++ type that counts its operations in place of ``real``: how many operations an update of a
stream needs.
"""

from __future__ import annotations

from pathlib import Path

NUMBER = """\
#pragma once
#include <cmath>
#include <cstdint>

extern int64_t operations;

/* A double that counts additions, multiplications, divisions and comparisons. */
struct counted {
    double value;
    counted() = default;
    constexpr counted(double x) : value(x) {}
    template <typename T> explicit operator T() const { return static_cast<T>(value); }
    counted operator-() const { return counted(-value); }
    counted &operator+=(counted b) { ++operations; value += b.value; return *this; }
    counted &operator-=(counted b) { ++operations; value -= b.value; return *this; }
    counted &operator*=(counted b) { ++operations; value *= b.value; return *this; }
    counted &operator/=(counted b) { ++operations; value /= b.value; return *this; }
};
inline counted operator+(counted a, counted b) { ++operations; return counted(a.value + b.value); }
inline counted operator-(counted a, counted b) { ++operations; return counted(a.value - b.value); }
inline counted operator*(counted a, counted b) { ++operations; return counted(a.value * b.value); }
inline counted operator/(counted a, counted b) { ++operations; return counted(a.value / b.value); }
inline bool operator<(counted a, counted b) { ++operations; return a.value < b.value; }
inline bool operator<=(counted a, counted b) { ++operations; return a.value <= b.value; }
inline bool operator>(counted a, counted b) { ++operations; return a.value > b.value; }
inline bool operator>=(counted a, counted b) { ++operations; return a.value >= b.value; }
inline bool operator==(counted a, counted b) { ++operations; return a.value == b.value; }
inline bool operator!=(counted a, counted b) { ++operations; return a.value != b.value; }
inline bool isfinite(counted a) { return std::isfinite(a.value); }

/* A call of the mathematics library counts as one operation. */
#define OF_ONE(f) inline counted f(counted a) { ++operations; return counted(std::f(a.value)); }
#define OF_TWO(f) inline counted f(counted a, counted b) { ++operations; return \
counted(std::f(a.value, b.value)); }
OF_ONE(sqrt) OF_ONE(log) OF_ONE(expm1) OF_ONE(log1p) OF_ONE(erf) OF_ONE(tan) OF_ONE(asin) \
OF_ONE(acos) OF_ONE(atan)
OF_ONE(sinh) OF_ONE(cosh) OF_ONE(asinh) OF_ONE(acosh) OF_ONE(atanh)
OF_TWO(atan2) OF_TWO(pow) OF_TWO(fmod) OF_TWO(remainder) OF_TWO(hypot)
"""

PROGRAM = """\
#include "@_inversion.h"
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <vector>

int64_t operations = 0;

/* Follow a smooth motion of the first output with limits that are too tight; print the most \
operations of an update. */
int main(int argc, char **argv)
{
    const int N = std::atoi(argv[1]), S = std::atoi(argv[2]), updates = 3 * N + 40;
    const @_stream_options options = {N, S, counted(5e-3), counted(1e-6), (@_hold)2, counted(3.5)};
    std::vector<counted> memory((size_t)@_STREAM_SIZE(N, S)), y(@_NT), dy(@_NY), ddy(@_NY), \
W(@_NY * @_NA), b(@_NY);
    std::vector<counted> zero(@_NA + @_NT, counted(0.0)), tau(@_NM * S), torque(@_NM, \
counted(1e9)), speed(@_NM);
    std::vector<counted> first(@_NT);
    @_motion motion = {nullptr, nullptr, nullptr, nullptr, nullptr, nullptr, tau.data()};
    const @_stream stream = {memory.data(), (int64_t)memory.size()};
    @_stream_info info;
    int64_t most = 0;
    int status = @_output_constraint(@_home_q_a, zero.data(), zero.data(), first.data(), \
W.data(), b.data());
    if (argc != 3 || status != 0) return 2;
    if (@_stream_start(&stream, &options, first.data(), @_home_q_a) < 0) return 3;
    for (int i = 0; i < @_NM; ++i) speed[i] = counted(0.5);
    if (N >= 12 && @_stream_limits(&stream, torque.data(), speed.data(), counted(0.1)) < 0) \
return 4;
    for (int k = 1; k <= updates; ++k) {
        const double T = updates * 5e-3, s = (double)k / updates, d = 0.2;
        for (int i = 0; i < @_NT; ++i) y[i] = first[i];
        for (int i = 0; i < @_NY; ++i) dy[i] = ddy[i] = counted(0.0);
        y[0] += counted(d * s * s * s * (10 - 15 * s + 6 * s * s));
        dy[0] = counted(d * 30 * s * s * (1 - s) * (1 - s) / T);
        ddy[0] = counted(d * 60 * s * (1 - s) * (1 - 2 * s) / (T * T));
        operations = 0;
        status = @_stream_update(&stream, y.data(), dy.data(), ddy.data(), &motion, &info);
        if (operations > most) most = operations;
        if (status < 0) break;
    }
    std::printf("%d %lld %lld ", status, (long long)most, (long long)@_STREAM_OPERATIONS(N, S));
    std::printf("%d\\n", info.limits_active);
    return 0;
}
"""


LIMIT = "@_stream_limits(&stream, torque.data(), speed.data(), counted(0.1))"
LIMIT_ALL = """\
[&] {
        static std::vector<counted> deflection(@_NE + 1, counted(1e-4)), each(@_NG, counted(1e3));
        static std::vector<counted> slow(@_NG, counted(0.2)), curve;
        for (int i = 0; i < @_NM; ++i) for (double x : {0.0, 1e3, 1e3, 5e2}) \
curve.push_back(counted(x));
        const @_inversion_limits all = {torque.data(), speed.data(), deflection.data(), 0, \
nullptr, each.data(),
            each.data(), slow.data(), slow.data(), counted(0.2), counted(0.2), curve.data(), 2};
        return @_stream_all_limits(&stream, &all, counted(0.1));
    }()"""


def counting_program(folder: Path, name: str, work: Path) -> Path:
    """A folder with the sources of a library whose numbers count, and ``main.cpp``; an amalgamated
    library is given.
    """
    NAME = name.upper()
    header = (folder / f"{name}.h").read_text(encoding="ascii")
    changed = header.replace(
        f"typedef double {name}_real;", f"typedef counted {name}_real;"
    ).replace(f"#define {NAME}_H\n", f'#define {NAME}_H\n#include "counted.h"\n', 1)
    # prototypes and structs of the inversion say double
    changed = changed.replace("double ", f"{name}_real ").replace(
        f"typedef {name}_real {name}_real;", ""
    )
    changed = changed.replace('extern "C" {', f'extern "C++" {{\ntypedef counted {name}_real;')
    source = (folder / f"{name}.c").read_text(encoding="ascii").replace("double ", f"{name}_real ")
    (work / f"{name}.h").write_text(changed, encoding="ascii")
    (work / f"{name}.cpp").write_text(source, encoding="ascii")
    (work / "counted.h").write_text(NUMBER, encoding="ascii")
    has_all = f"{name}_stream_all_limits(" in header
    text = (
        PROGRAM.replace(LIMIT, LIMIT_ALL if has_all else LIMIT)
        .replace('"@_inversion.h"', f'"{name}.h"')
        .replace("(@_STREAM", f"({NAME}_STREAM")
    )
    for size in ("NA", "NE", "NG", "NM", "NY", "NT", "STREAM_SIZE", "STREAM_OPERATIONS"):
        text = text.replace(f"@_{size}", f"{NAME}_{size}")
    (work / "main.cpp").write_text(text.replace("@", name), encoding="ascii")
    return work
