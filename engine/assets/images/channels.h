// Text and channels in the file of a picture.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <string_view>

namespace raynest {

/// A line of text in the header of a file.
struct Attribute {
    std::string name;
    std::string value;
};

/// A named channel of 32-bit values for EXR. Exactly one of the two spans is set, with width *
/// height values, row 0 on top.
struct Channel {
    std::string_view name;
    std::span<const float> f32;
    std::span<const std::uint32_t> u32;
};

/// The name and type of a channel of 32 bits.
struct ChannelType {
    std::string name;
    bool is_float = true;  ///< else u32
    friend bool operator==(const ChannelType&, const ChannelType&) = default;
};

}  // namespace raynest
