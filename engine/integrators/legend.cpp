#include "engine/integrators/legend.h"

#include "engine/integrators/font.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace raynest {
namespace {

constexpr Colour paper{22, 24, 29};
constexpr Colour ink{232, 232, 232};

// Pixels at scale 1.
constexpr std::uint32_t margin = 6;
constexpr std::uint32_t bar_height = 10;
constexpr std::uint32_t tick_height = 3;
constexpr std::uint32_t gap = 2;
constexpr std::uint32_t label_gap = 10;
constexpr std::uint32_t large_picture_width = 800;  ///< from here on letters are twice as large

constexpr std::string_view log_suffix = ", log scale";

/// The title is the longest text that cannot be broken into lines.
constexpr bool fits(std::string_view title) {
    return (title.size() + log_suffix.size()) * glyph_advance <=
           heat_picture_width_min - 2 * margin;
}
#define RAYNEST_COUNTER(name, title) static_assert(fits(title), "the title of " #name);
#include "engine/geometry/counters.def"
#define RAYNEST_MEASURE(name, title) static_assert(fits(title), "the title of " #name);
#include "engine/integrators/measures.def"

/// The title of a metric that heat_statistics() knows.
std::string title_of(const HeatMetric& metric) {
    switch (metric.measure) {
#define RAYNEST_MEASURE(name, title) \
    case Measure::name:              \
        return title;
#include "engine/integrators/measures.def"
        case Measure::none:
            break;
    }
    return std::string(field_info(metric.counter.field).title);
}

std::string number(double value, int digits) {
    std::array<char, 64> text{};
    const auto end = std::to_chars(text.data(), text.data() + text.size(), value,
                                   std::chars_format::fixed, digits);
    return {text.data(), end.ptr};
}

/// Returns the text of a number, with a plus if that is told.
std::string signed_text(const std::string& text, bool plus = true) {
    return std::string(plus ? "+" : "").append(text);
}

/// 12, 0.5, 250k, 3M: as short as a tick allows.
std::string tick_label(double value) {
    const bool millions = std::abs(value) >= 1e6;
    const bool thousands = !millions && std::abs(value) >= 1e5;
    const double shown = millions ? value / 1e6 : thousands ? value / 1e3 : value;
    std::array<char, 64> text{};
    const auto end =
        std::to_chars(text.data(), text.data() + text.size(), shown, std::chars_format::general, 5);
    return std::string(text.data(), end.ptr) + (millions ? "M" : thousands ? "k" : "");
}

/// Round values inside the range: steps of 1, 2 or 5 times a power of ten, or such numbers
/// themselves on a logarithmic scale.
std::vector<double> round_values(const HeatScale& scale, std::uint32_t count_max) {
    std::vector<double> values;
    if (scale.logarithmic) {
        for (std::uint64_t decade = 1; static_cast<double>(decade) < scale.high; decade *= 10) {
            for (const unsigned digit : {1U, 2U, 5U}) {
                values.push_back(static_cast<double>(decade * digit));
                if (scale.centred) values.push_back(-values.back());
            }
        }
    } else {
        const double wanted = (scale.high - scale.low) / count_max;
        double step = std::pow(10.0, std::floor(std::log10(wanted)));
        for (const double factor : {2.0, 2.5, 2.0}) {
            if (step < wanted) step *= factor;
        }
        step = std::max(step, 1.0);  // counts are whole
        for (std::uint32_t i = 0; i <= 2 * count_max; ++i) {
            values.push_back((std::ceil(scale.low / step) + i) * step);
        }
    }
    std::erase_if(values, [&](double v) { return v <= scale.low || v >= scale.high; });
    return values;
}

/// Joins words with three blanks into lines that fit; a word that is too long gets its own.
std::vector<std::string> flow(const std::vector<std::string>& words, std::uint32_t width,
                              std::uint32_t text_scale) {
    std::vector<std::string> lines;
    for (const std::string& word : words) {
        const std::string joined = lines.empty() ? word : lines.back() + "   " + word;
        if (lines.empty() || text_width(joined, text_scale) > width) {
            lines.push_back(word);
        } else {
            lines.back() = joined;
        }
    }
    return lines;
}

/// Cuts words that do not fit a line, and ends them in dots.
std::vector<std::string> cut(std::vector<std::string> words, std::uint32_t width,
                             std::uint32_t text_scale) {
    constexpr std::string_view dots = "...";
    for (std::string& word : words) {
        if (text_width(word, text_scale) <= width) continue;
        while (!word.empty() && text_width(word, text_scale) + text_width(dots, text_scale) > width)
            word.pop_back();
        word += dots;
    }
    return words;
}

std::vector<std::string> statistic_words(const HeatStatistics& s, const HeatOptions& options,
                                         bool of_difference) {
    const auto share = [](double part) { return number(100 * part, 1) + "%"; };
    const auto whole = [&](std::int64_t value) {
        return signed_text(std::to_string(value), of_difference && value > 0);
    };
    const std::string mean = signed_text(number(s.mean, 1), of_difference && s.mean > 0);
    std::vector<std::string> words{"min " + whole(s.min), "mean " + mean,
                                   "p50 " + whole(s.p50), "p99 " + whole(s.p99),
                                   "max " + whole(s.max), "clipped " + share(s.clipped)};
    if (s.below > 0) words.push_back("below " + share(s.below));
    if (const auto metric = parse_metric(options.metric); metric && metric->counter.of_level())
        words.push_back(
            std::string("level ").append(std::to_string(metric->counter.level)).append(" only"));
    if (options.count == "necessary") words.emplace_back("necessary only");
    if (of_difference) words.emplace_back("difference: + costs more");
    return words;
}

class Legend {
public:
    Legend(Picture& picture, const Palette& palette, const HeatScale& scale,
           const HeatStatistics& statistics, const HeatOptions& options)
        : picture_(picture),
          palette_(palette),
          scale_(scale),
          statistics_(statistics) {
        if (const auto metric = parse_metric(options.metric)) title_ = title_of(*metric);
        if (scale.logarithmic) title_ += log_suffix;
        widen();
        view_ = flow(cut(options.view, inner_width(), unit_), inner_width(), unit_);
        numbers_ = flow(statistic_words(statistics, options, scale.centred), inner_width(), unit_);
    }

    void append() {
        const std::uint32_t top = picture_.height;
        const auto lines = static_cast<std::uint32_t>(view_.size() + numbers_.size()) + 2;
        picture_.height +=
            unit_ * (2 * margin + bar_height + tick_height + 3 * gap + lines * line_advance);
        picture_.rgba.resize(std::size_t{4} * picture_.width * picture_.height);
        fill(0, top, picture_.width, picture_.height - top, paper);

        std::uint32_t y = top + unit_ * margin;
        for (const std::string& line : view_) y = write_line(line, y);
        y = write_line(title_, y);
        y = draw_bar(y) + unit_ * gap;
        y = draw_ticks(y) + unit_ * gap;
        for (const std::string& line : numbers_) y = write_line(line, y);
    }

private:
    void widen() {
        const std::uint32_t width = picture_.width;
        if (width >= heat_picture_width_min) return;
        Picture wide{heat_picture_width_min, picture_.height, {}};
        wide.rgba.resize(std::size_t{4} * wide.width * wide.height);
        for (std::size_t y = 0; y < wide.height; ++y) {
            std::copy_n(&picture_.rgba[4 * y * width], std::size_t{4} * width,
                        &wide.rgba[4 * y * wide.width]);
        }
        picture_ = std::move(wide);
        fill(width, 0, picture_.width - width, picture_.height, paper);
    }

    [[nodiscard]] std::uint32_t inner_width() const { return picture_.width - 2 * unit_ * margin; }

    void fill(std::uint32_t x, std::uint32_t y, std::uint32_t width, std::uint32_t height,
              Colour colour) {
        for (std::uint32_t row = y; row < std::min(y + height, picture_.height); ++row) {
            for (std::uint32_t column = x; column < std::min(x + width, picture_.width); ++column) {
                std::uint8_t* pixel =
                    &picture_.rgba[4 * (std::size_t{row} * picture_.width + column)];
                pixel[0] = colour.r;
                pixel[1] = colour.g;
                pixel[2] = colour.b;
                pixel[3] = 255;
            }
        }
    }

    std::uint32_t write_line(const std::string& line, std::uint32_t y) {
        draw_text(picture_, std::int64_t{unit_} * margin, y, line, unit_, ink);
        return y + unit_ * line_advance;
    }

    std::uint32_t draw_bar(std::uint32_t y) {
        const std::uint32_t width = inner_width();
        for (std::uint32_t x = 0; x < width; ++x) {
            fill(unit_ * margin + x, y, 1, unit_ * bar_height,
                 palette_[std::size_t{x} * palette_.size() / width]);
        }
        return y + unit_ * bar_height;
    }

    /// Both ends first, then the round values that leave room for their labels.
    std::uint32_t draw_ticks(std::uint32_t y) {
        const bool above = statistics_.clipped > 0;
        const bool below = statistics_.below > 0;
        if (scale_.centred) {
            draw_tick(scale_.low, std::string(below ? "<" : "").append(tick_label(scale_.low)), y);
            draw_tick(scale_.high,
                      std::string(above ? ">" : "").append(signed_text(tick_label(scale_.high))),
                      y);
            draw_tick(0, "0", y);
        } else {
            draw_tick(scale_.low, tick_label(scale_.low) + (below ? "-" : ""), y);
            draw_tick(scale_.high, tick_label(scale_.high) + (above ? "+" : ""), y);
        }
        const std::uint32_t count_max = std::clamp(inner_width() / (60 * unit_), 1U, 10U);
        for (const double value : round_values(scale_, count_max)) {
            draw_tick(value, signed_text(tick_label(value), scale_.centred && value > 0), y);
        }
        return y + unit_ * (tick_height + gap + line_advance);
    }

    void draw_tick(double value, const std::string& label, std::uint32_t y) {
        const std::uint32_t left = unit_ * margin;
        const std::uint32_t right = left + inner_width() - 1;
        const auto x =
            left + static_cast<std::uint32_t>(std::lround(scale_.position(value) * (right - left)));
        const std::uint32_t width = text_width(label, unit_);
        const std::uint32_t wanted = x > left + width / 2 ? x - width / 2 : left;
        const std::uint32_t last = right + 1 > left + width ? right + 1 - width : left;
        const Span span{std::min(wanted, last), std::min(wanted, last) + width};
        const bool free = std::none_of(labels_.begin(), labels_.end(), [&](const Span& other) {
            return span.begin < other.end + unit_ * label_gap &&
                   other.begin < span.end + unit_ * label_gap;
        });
        if (!free) return;
        labels_.push_back(span);
        fill(std::min(x, right + 1 - unit_), y, unit_, unit_ * tick_height, ink);
        draw_text(picture_, span.begin, y + unit_ * (tick_height + gap), label, unit_, ink);
    }

    struct Span {
        std::uint32_t begin, end;
    };

    Picture& picture_;
    const Palette& palette_;
    const HeatScale& scale_;
    const HeatStatistics& statistics_;
    const std::uint32_t unit_ = picture_.width >= large_picture_width ? 2 : 1;
    std::string title_;
    std::vector<std::string> view_;
    std::vector<std::string> numbers_;
    std::vector<Span> labels_;
};

}  // namespace

double HeatScale::position(double count) const {
    if (centred) {
        const double distance = std::min(std::abs(count), high);
        const double part = logarithmic ? std::log1p(distance) / std::log1p(high) : distance / high;
        return 0.5 + std::copysign(part / 2, count);
    }
    const double place = !logarithmic ? (count - low) / (high - low)
                         : low >= 1
                             ? std::log(count / low) / std::log(high / low)
                             : std::log1p(std::max(count - low, 0.0)) / std::log1p(high - low);
    return std::clamp(place, 0.0, 1.0);
}

void append_legend(Picture& picture, const Palette& palette, const HeatScale& scale,
                   const HeatStatistics& statistics, const HeatOptions& options) {
    Legend(picture, palette, scale, statistics, options).append();
}

}  // namespace raynest
