// From an intersector's type to its C descriptors, and from a call's values to an intersector.
#pragma once

#include "engine/intersectors/params.h"
#include "engine/packs/abi.h"

#include <array>
#include <cstddef>
#include <cstdint>
#include <tuple>
#include <type_traits>

namespace raynest {

/// The ValueType of a parameter or output; param() and output() take no other types.
template <class T>
inline constexpr ValueType value_type = std::is_same_v<T, float> ? value_f32 : value_u32;

template <class Owner, class T>
constexpr PackParam describe(const Param<Owner, T>& p, const Owner& initial) {
    return {p.name,
            p.text,
            value_type<T>,
            0,
            nullptr,
            static_cast<double>(p.minimum),
            static_cast<double>(p.maximum),
            static_cast<double>(initial.*p.member)};
}
template <class Owner, class T, std::size_t N>
constexpr PackParam describe(const Choice<Owner, T, N>& p, const Owner& initial) {
    return {p.name,
            p.text,
            value_choice,
            N,
            p.choices.data(),
            0.0,
            static_cast<double>(N - 1),
            static_cast<double>(initial.*p.member)};
}
template <class Owner>
constexpr PackParam describe(const TableParam<Owner>& p, const Owner& /*initial*/) {
    return {p.name,
            p.text,
            value_table,
            0,
            nullptr,
            static_cast<double>(p.minimum),
            static_cast<double>(p.maximum),
            0.0};
}
template <class Owner, class T>
constexpr PackOutput describe(const Output<Owner, T>& o) {
    return {o.name, o.text, value_type<T>};
}

template <class Isect>
constexpr auto describe_params() {
    if constexpr (requires { Isect::params; }) {
        return std::apply(
            [](const auto&... p) {
                return std::array<PackParam, sizeof...(p)>{
                    describe(p, typename Isect::Params{})...};
            },
            Isect::params);
    } else {
        return std::array<PackParam, 0>{};
    }
}

template <class Isect>
constexpr auto describe_outputs() {
    if constexpr (requires { Isect::outputs; }) {
        return std::apply(
            [](const auto&... o) { return std::array<PackOutput, sizeof...(o)>{describe(o)...}; },
            Isect::outputs);
    } else {
        return std::array<PackOutput, 0>{};
    }
}

struct NoParams {};
template <class Isect>
struct ParamsOf {
    using type = NoParams;
};
template <class Isect>
requires requires {
    typename Isect::Params;
}
struct ParamsOf<Isect> {
    using type = typename Isect::Params;
};

/// The call's values, or the initial ones.
template <class Isect>
typename ParamsOf<Isect>::type read_params(const TraceCall& call) {
    typename ParamsOf<Isect>::type values;
    if constexpr (requires { Isect::params; }) {
        std::size_t param = 0;
        std::size_t table = 0;
        const auto assign = [&](const auto& p) {
            auto& member = values.*p.member;
            using T = std::remove_reference_t<decltype(member)>;
            if constexpr (std::is_same_v<T, Table>) {
                if (call.tables != nullptr) member = call.tables[table++];
            } else if (call.params != nullptr) {
                if constexpr (std::is_enum_v<T>) {
                    member = static_cast<T>(static_cast<std::uint32_t>(call.params[param]));
                } else {
                    member = static_cast<T>(call.params[param]);
                }
            }
            ++param;
        };
        std::apply([&](const auto&... p) { (assign(p), ...); }, Isect::params);
    }
    return values;
}

template <class Isect>
RAYNEST_FN Isect make_intersector(const SceneView& scene,
                                  const typename ParamsOf<Isect>::type& values) {
    if constexpr (requires { typename Isect::Params; }) {
        return Isect(scene, values);
    } else {
        return Isect{};
    }
}
template <class Isect>
Isect make_intersector(const TraceCall& call) {
    return make_intersector<Isect>(*call.scene, read_params<Isect>(call));
}

/// True if a parameter is a table, which a device with its own memory cannot read.
template <class Isect>
constexpr bool takes_tables() {
    for (const PackParam& param : describe_params<Isect>()) {
        if (param.type == value_table) return true;
    }
    return false;
}

struct NoOutputs {};
template <class Isect>
struct OutputsOf {
    using type = NoOutputs;
};
template <class Isect>
requires requires {
    typename Isect::Outputs;
}
struct OutputsOf<Isect> {
    using type = typename Isect::Outputs;
};

template <class Isect>
inline constexpr auto described_params = describe_params<Isect>();
template <class Isect>
inline constexpr auto described_outputs = describe_outputs<Isect>();

/// The variant without its functions.
template <class Isect>
constexpr PackVariant describe_variant(const char* name) {
    constexpr const auto& params = described_params<Isect>;
    constexpr const auto& outputs = described_outputs<Isect>;
    PackVariant v{};
    v.name = name;
    v.text = Isect::text;
    v.params = params.data();
    v.param_count = static_cast<std::uint32_t>(params.size());
    v.outputs = outputs.data();
    v.output_count = static_cast<std::uint32_t>(outputs.size());
    return v;
}

}  // namespace raynest
