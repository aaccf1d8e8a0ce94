// The types of generator settings in generators.def, and how they are read.
#pragma once

#include "engine/geometry/pinhole.h"
#include "server/ground/errors.h"

#include <cstdint>
#include <limits>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::server::setting {

/// The text as given.
struct Name {
    std::string value;
};
/// A value that comes in the frames of a query; the text is ignored.
struct Sent {};
/// WIDTHxHEIGHT
struct Size {
    ImageSize value;
};
/// Finite numbers that fit float32, with all digits of float64: the ray is what rounds them. Their
/// count depends on the derived type.
struct Reals {
    std::vector<double> values;
    [[nodiscard]] double at(std::size_t i) const { return values[i]; }
    [[nodiscard]] glm::dvec3 vector(std::size_t i) const {
        return {values[3 * i], values[3 * i + 1], values[3 * i + 2]};
    }
};
struct Number : Reals {};
struct Window : Reals {};
struct LookAt : Reals {};
struct Matrix : Reals {};
struct Numbers : Reals {};
struct Vectors : Reals {};
/// Numbers, or LOWEST:HIGHEST:COUNT
struct Steps : Reals {};
/// Degrees from 0 to below 180.
struct Angle {
    float value = 0;
};
/// START:STOP:COUNT
struct Sweep {
    double start = 0, stop = 360;
    std::uint32_t count = 0;
};
/// NEAR:FAR
struct Range {
    float tmin = 0, tmax = std::numeric_limits<float>::infinity();
};
struct Samples {
    std::uint32_t value = 64;
};
struct Whole {
    std::uint64_t value = 0;
};

// read() for each setting type of generators.def. Fails with INVALID_FIELD or LIMIT_EXCEEDED and
// says what is wrong with the text; the caller adds the name of the setting.
#define RAYNEST_SETTING(name, type, description) \
    Reply<void> read(std::string_view text, type& value);
#include "protocol/lists/generators.def"

}  // namespace raynest::server::setting
