// How an intersector declares its parameters and per-ray outputs.
//
//     struct Params { float scale = 8; Pattern pattern = Pattern::discs; };
//     static constexpr auto params = std::tuple{
//         param("scale", &Params::scale, 0.001F, 1e6F, "cells per unit of u and v"),
//         param("pattern", &Params::pattern, choices, "shape of the holes"),
//         param("curve", &Params::curve, 0.0F, 1.0F, "weight of each step")};    // Table curve;
//     struct Outputs { std::uint32_t refused = 0; };
//     static constexpr auto outputs = std::tuple{output("refused", &Outputs::refused, "...")};
//     Outputs* state = nullptr;            // one per ray of the chunk: state[ray.id]
//     X(const SceneView& scene, const Params& params);
//
// This declaration is the only source of the names, types, ranges, defaults and texts that `raynest
// variants`, the check of --set and the columns of a reply use.
#pragma once

#include "engine/intersectors/table.h"

#include <array>
#include <cstddef>
#include <cstdint>
#include <type_traits>

namespace raynest {

template <class Owner, class T>
struct Param {
    const char* name;
    T Owner::*member;
    T minimum;
    T maximum;
    const char* text;
};

template <class Owner, class T, std::size_t N>
struct Choice {
    const char* name;
    T Owner::*member;
    const std::array<const char*, N>& choices;  ///< names of the enumerators 0..N-1
    const char* text;
};

template <class Owner>
struct TableParam {
    const char* name;
    Table Owner::*member;
    float minimum;
    float maximum;
    const char* text;
};

template <class Owner, class T>
struct Output {
    const char* name;
    T Owner::*member;
    const char* text;
};

/// Declares a float or std::uint32_t within [minimum, maximum]. The default is the member's
/// initialiser and may lie outside (to mean "not set").
template <class Owner, class T>
requires(std::is_same_v<T, float> ||
         std::is_same_v<T, std::uint32_t>) constexpr Param<Owner, T> param(const char* name,
                                                                           T Owner::*member,
                                                                           T minimum, T maximum,
                                                                           const char* text) {
    return {name, member, minimum, maximum, text};
}

/// Declares an enumeration; `choices` has static storage.
template <class Owner, class T, std::size_t N>
requires std::is_enum_v<T>
constexpr Choice<Owner, T, N> param(const char* name, T Owner::*member,
                                    const std::array<const char*, N>& choices, const char* text) {
    return {name, member, choices, text};
}

/// Declares a table whose values all lie within [minimum, maximum]. It is empty unless a request
/// brings values.
template <class Owner>
constexpr TableParam<Owner> param(const char* name, Table Owner::*member, float minimum,
                                  float maximum, const char* text) {
    return {name, member, minimum, maximum, text};
}

/// Declares a float or std::uint32_t output per ray, also written for misses.
template <class Owner, class T>
requires(std::is_same_v<T, float> ||
         std::is_same_v<T, std::uint32_t>) constexpr Output<Owner, T> output(const char* name,
                                                                             T Owner::*member,
                                                                             const char* text) {
    return {name, member, text};
}

/// True if the intersector writes outputs per ray.
template <class Isect>
inline constexpr bool has_outputs = requires {
    Isect::outputs;
};

}  // namespace raynest
