#include "server/requests/words/idle_options.h"

#include "engine/integrators/integrator.h"

#include <algorithm>
#include <array>
#include <initializer_list>

namespace raynest::server {
namespace {

/// An option that a request may have.
struct Option {
    std::string_view name;
    bool (*is_given)(const RenderWords&);
    bool is_of_films = false;  ///< all integrators use it
};

constexpr std::array options = {
    Option{"samples", [](const RenderWords& w) { return w.samples > 1; }, true},
    Option{"seed", [](const RenderWords& w) { return w.seed != 0; }, true},
#define RAYNEST_INTEGRATOR_SETTING(name, ...) \
    Option{#name, [](const RenderWords& w) { return w.name != 0; }},
#include "engine/integrators/integrator_settings.def"
    Option{"environment", [](const RenderWords& w) { return w.environment != "auto"; }},
    Option{"environment_rotate", [](const RenderWords& w) { return w.environment_rotate != 0; }},
    Option{"sun", [](const RenderWords& w) { return w.sun; }},
    Option{"noise", [](const RenderWords& w) { return w.noise != 0; }, true},
    Option{"tonemap", [](const RenderWords& w) { return !w.tonemap.empty(); }, true},
    Option{"exposure", [](const RenderWords& w) { return !w.exposure.empty(); }, true},
    Option{"progressive", [](const RenderWords& w) { return w.progressive; }, true},
};

/// True if each setting of an integrator is an option here.
constexpr bool are_known(std::initializer_list<std::string_view> settings) {
    return std::ranges::all_of(settings, [](std::string_view setting) {
        return std::ranges::find(options, setting, &Option::name) != options.end();
    });
}
#define RAYNEST_INTEGRATOR(name, Type, lit, text, ...)                             \
    static_assert(are_known({__VA_ARGS__}), "integrators.def: a setting of " #name \
                                            " is no "                              \
                                            "option");
#include "engine/integrators/integrators.def"

/// `info` is null for primary, which uses none.
bool uses(const IntegratorInfo* info, const Option& option) {
    return info != nullptr &&
           (option.is_of_films ||
            std::ranges::find(info->settings, option.name) != info->settings.end());
}

void add(std::string& list, std::string_view name) {
    list.append(list.empty() ? "`" : ", `").append(name).append("`");
}

/// "" where the list is empty.
std::string note_of(std::string_view where, const std::string& list) {
    return list.empty() ? "" : "no effect " + std::string(where) + ": " + list;
}

}  // namespace

std::string idle_options_note(const RenderWords& words) {
    // A picture that is continued repeats all options of the one before.
    if (words.resume_bytes != 0) return {};
    const bool linear = words.encode == "exr";
    const auto table = integrator_table();
    const auto found = std::ranges::find(table, words.integrator, &IntegratorInfo::name);
    const IntegratorInfo* const info = found == table.end() ? nullptr : &*found;
    std::string by_integrator, by_file;
    for (const Option& option : options) {
        if (!option.is_given(words)) continue;
        if (!uses(info, option))
            add(by_integrator, option.name);
        else if (linear && (option.name == "tonemap" || option.name == "exposure"))
            add(by_file, option.name);
    }
    std::string note = note_of("with integrator " + std::string(words.integrator), by_integrator);
    if (!by_file.empty())
        note.append(note.empty() ? "" : "; ")
            .append(note_of("on an EXR, which is linear", by_file));
    return note;
}

std::string idle_colours_note(std::string_view palette, std::string_view scale,
                              std::string_view file) {
    if (file == "png") return {};
    std::string colours;
    if (!palette.empty()) add(colours, "palette");
    if (scale != "linear") add(colours, "scale");
    return note_of("on counts, which have no colours", colours);
}

std::string idle_boxes_note(bool skips_boxes, bool hides_nothing) {
    std::string boxes;
    if (hides_nothing && skips_boxes) add(boxes, "skip_hidden_boxes");
    return note_of("without `hide` or `only`", boxes);
}

}  // namespace raynest::server
