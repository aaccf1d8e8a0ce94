#include "engine/integrators/font.h"

#include <array>
#include <cstddef>

namespace raynest {
namespace {

constexpr std::size_t columns = 5;

/// Rows from the top, apart by a blank; rows eight and nine hang below the base line.
struct Glyph {
    char letter;
    std::string_view rows;

    [[nodiscard]] constexpr std::size_t row_count() const {
        return (rows.size() + 1) / (columns + 1);
    }
    [[nodiscard]] constexpr bool is_set(std::size_t row, std::size_t column) const {
        return rows[row * (columns + 1) + column] == '#';
    }
};

// clang-format off
constexpr Glyph unknown{'\0', "##### #...# #...# #...# #...# #...# #####"};
constexpr std::array glyphs{
    Glyph{'0', ".###. #...# #..## #.#.# ##..# #...# .###."},
    Glyph{'1', "..#.. .##.. #.#.. ..#.. ..#.. ..#.. #####"},
    Glyph{'2', ".###. #...# ....# ...#. ..#.. .#... #####"},
    Glyph{'3', ".###. #...# ....# ..##. ....# #...# .###."},
    Glyph{'4', "...#. ..##. .#.#. #..#. ##### ...#. ...#."},
    Glyph{'5', "##### #.... ####. ....# ....# #...# .###."},
    Glyph{'6', "..##. .#... #.... ####. #...# #...# .###."},
    Glyph{'7', "##### ....# ...#. ..#.. ..#.. .#... .#..."},
    Glyph{'8', ".###. #...# #...# .###. #...# #...# .###."},
    Glyph{'9', ".###. #...# #...# .#### ....# ...#. .##.."},
    Glyph{'A', "..#.. .#.#. #...# #...# ##### #...# #...#"},
    Glyph{'B', "####. #...# #...# ####. #...# #...# ####."},
    Glyph{'C', ".###. #...# #.... #.... #.... #...# .###."},
    Glyph{'D', "###.. #..#. #...# #...# #...# #..#. ###.."},
    Glyph{'E', "##### #.... #.... ####. #.... #.... #####"},
    Glyph{'F', "##### #.... #.... ####. #.... #.... #...."},
    Glyph{'G', ".###. #...# #.... #.### #...# #...# .###."},
    Glyph{'H', "#...# #...# #...# ##### #...# #...# #...#"},
    Glyph{'I', ".###. ..#.. ..#.. ..#.. ..#.. ..#.. .###."},
    Glyph{'J', "..### ...#. ...#. ...#. ...#. #..#. .##.."},
    Glyph{'K', "#...# #..#. #.#.. ##... #.#.. #..#. #...#"},
    Glyph{'L', "#.... #.... #.... #.... #.... #.... #####"},
    Glyph{'M', "#...# ##.## #.#.# #.#.# #...# #...# #...#"},
    Glyph{'N', "#...# ##..# ##..# #.#.# #..## #..## #...#"},
    Glyph{'O', ".###. #...# #...# #...# #...# #...# .###."},
    Glyph{'P', "####. #...# #...# ####. #.... #.... #...."},
    Glyph{'Q', ".###. #...# #...# #...# #.#.# #..#. .##.#"},
    Glyph{'R', "####. #...# #...# ####. #.#.. #..#. #...#"},
    Glyph{'S', ".#### #.... #.... .###. ....# ....# ####."},
    Glyph{'T', "##### ..#.. ..#.. ..#.. ..#.. ..#.. ..#.."},
    Glyph{'U', "#...# #...# #...# #...# #...# #...# .###."},
    Glyph{'V', "#...# #...# #...# #...# .#.#. .#.#. ..#.."},
    Glyph{'W', "#...# #...# #...# #.#.# #.#.# ##.## #...#"},
    Glyph{'X', "#...# #...# .#.#. ..#.. .#.#. #...# #...#"},
    Glyph{'Y', "#...# #...# .#.#. ..#.. ..#.. ..#.. ..#.."},
    Glyph{'Z', "##### ....# ...#. ..#.. .#... #.... #####"},
    Glyph{'a', "..... ..... .###. ....# .#### #...# .####"},
    Glyph{'b', "#.... #.... ####. #...# #...# #...# ####."},
    Glyph{'c', "..... ..... .###. #...# #.... #...# .###."},
    Glyph{'d', "....# ....# .#### #...# #...# #...# .####"},
    Glyph{'e', "..... ..... .###. #...# ##### #.... .###."},
    Glyph{'f', "..##. .#..# .#... ###.. .#... .#... .#..."},
    Glyph{'g', "..... ..... .#### #...# #...# #...# .#### ....# .###."},
    Glyph{'h', "#.... #.... ####. #...# #...# #...# #...#"},
    Glyph{'i', "..#.. ..... .##.. ..#.. ..#.. ..#.. .###."},
    Glyph{'j', "...#. ..... ..##. ...#. ...#. ...#. ...#. #..#. .##.."},
    Glyph{'k', "#.... #.... #..#. #.#.. ##... #.#.. #..#."},
    Glyph{'l', ".##.. ..#.. ..#.. ..#.. ..#.. ..#.. .###."},
    Glyph{'m', "..... ..... ##.#. #.#.# #.#.# #.#.# #.#.#"},
    Glyph{'n', "..... ..... ####. #...# #...# #...# #...#"},
    Glyph{'o', "..... ..... .###. #...# #...# #...# .###."},
    Glyph{'p', "..... ..... ####. #...# #...# #...# ####. #.... #...."},
    Glyph{'q', "..... ..... .#### #...# #...# #...# .#### ....# ....#"},
    Glyph{'r', "..... ..... #.##. ##..# #.... #.... #...."},
    Glyph{'s', "..... ..... .#### #.... .###. ....# ####."},
    Glyph{'t', ".#... .#... ###.. .#... .#... .#..# ..##."},
    Glyph{'u', "..... ..... #...# #...# #...# #...# .####"},
    Glyph{'v', "..... ..... #...# #...# #...# .#.#. ..#.."},
    Glyph{'w', "..... ..... #...# #.#.# #.#.# #.#.# .#.#."},
    Glyph{'x', "..... ..... #...# .#.#. ..#.. .#.#. #...#"},
    Glyph{'y', "..... ..... #...# #...# #...# #...# .#### ....# .###."},
    Glyph{'z', "..... ..... ##### ...#. ..#.. .#... #####"},
    Glyph{' ', ""},
    Glyph{'.', "..... ..... ..... ..... ..... .##.. .##.."},
    Glyph{',', "..... ..... ..... ..... ..... .##.. .##.. ..#.. .#..."},
    Glyph{':', "..... ..... .##.. .##.. ..... .##.. .##.."},
    Glyph{'+', "..... ..#.. ..#.. ##### ..#.. ..#.. ....."},
    Glyph{'-', "..... ..... ..... ##### ..... ..... ....."},
    Glyph{'=', "..... ..... ##### ..... ##### ..... ....."},
    Glyph{'/', "....# ....# ...#. ..#.. .#... #.... #...."},
    Glyph{'%', "##..# ##..# ...#. ..#.. .#... #..## #..##"},
    Glyph{'(', "...#. ..#.. .#... .#... .#... ..#.. ...#."},
    Glyph{')', ".#... ..#.. ...#. ...#. ...#. ..#.. .#..."},
    Glyph{'<', "...#. ..#.. .#... #.... .#... ..#.. ...#."},
    Glyph{'>', ".#... ..#.. ...#. ....# ...#. ..#.. .#..."},
    Glyph{'_', "..... ..... ..... ..... ..... ..... ..... #####"},
    Glyph{'#', ".#.#. .#.#. ##### .#.#. ##### .#.#. .#.#."},
    Glyph{'*', "..... ..#.. #.#.# .###. #.#.# ..#.. ....."},
};
// clang-format on

const Glyph& find_glyph(char letter) {
    for (const Glyph& glyph : glyphs) {
        if (glyph.letter == letter) return glyph;
    }
    return unknown;
}

void set_pixel(Picture& picture, std::int64_t x, std::int64_t y, Colour colour) {
    if (x < 0 || y < 0 || x >= picture.width || y >= picture.height) return;
    const auto at = 4 * (static_cast<std::size_t>(y) * picture.width + static_cast<std::size_t>(x));
    picture.rgba[at] = colour.r;
    picture.rgba[at + 1] = colour.g;
    picture.rgba[at + 2] = colour.b;
    picture.rgba[at + 3] = 255;
}

}  // namespace

std::uint32_t text_width(std::string_view text, std::uint32_t scale) {
    if (text.empty()) return 0;
    return (static_cast<std::uint32_t>(text.size()) * glyph_advance - 1) * scale;
}

void draw_text(Picture& picture, std::int64_t x, std::int64_t y, std::string_view text,
               std::uint32_t scale, Colour colour) {
    for (const char letter : text) {
        const Glyph& glyph = find_glyph(letter);
        for (std::size_t row = 0; row < glyph.row_count(); ++row) {
            for (std::size_t column = 0; column < columns; ++column) {
                if (!glyph.is_set(row, column)) continue;
                for (std::uint32_t i = 0; i < scale * scale; ++i) {
                    set_pixel(picture, x + static_cast<std::int64_t>(column * scale + i % scale),
                              y + static_cast<std::int64_t>(row * scale + i / scale), colour);
                }
            }
        }
        x += static_cast<std::int64_t>(glyph_advance * scale);
    }
}

}  // namespace raynest
