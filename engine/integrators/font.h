// Text for legends: a bitmap font of our own, five by seven with two rows for descenders.
//
// Legends are drawn by the daemon into pictures of any size; a font file or a text library would be
// a dependency for forty words.
#pragma once

#include "engine/integrators/picture.h"

#include <cstdint>
#include <string_view>

namespace raynest {

/// Pixels at scale 1: a glyph with the gap to the next one, and a line with the gap to the next
/// one.
inline constexpr std::uint32_t glyph_advance = 6;
inline constexpr std::uint32_t line_advance = 11;

struct Colour {
    std::uint8_t r = 0, g = 0, b = 0;
};

/// Width of the text in pixels.
[[nodiscard]] std::uint32_t text_width(std::string_view text, std::uint32_t scale);

/// Draws the text with its upper left corner at (x, y); what falls outside the picture is cut off.
/// ASCII letters, digits and the punctuation of legends; anything else becomes a box.
void draw_text(Picture& picture, std::int64_t x, std::int64_t y, std::string_view text,
               std::uint32_t scale, Colour colour);

}  // namespace raynest
