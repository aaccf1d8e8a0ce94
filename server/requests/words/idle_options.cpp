#include "server/requests/words/idle_options.h"

#include "engine/integrators/integrator.h"
#include "protocol/text.h"

#include <algorithm>
#include <array>
#include <initializer_list>

namespace raynest::server {
namespace {

using wire::Render;

/// An option that a request may have.
struct Option {
    std::string_view name;
    bool (*is_given)(const Render&);
    bool is_of_films = false;  ///< all integrators use it
};

constexpr std::array options = {
    Option{"samples", [](const Render& m) { return m.samples() > 1; }, true},
    Option{"seed", [](const Render& m) { return m.seed() != 0; }, true},
    Option{"depth", [](const Render& m) { return m.depth() != 0; }},
    Option{"ao_distance", [](const Render& m) { return m.ao_distance() != 0; }},
    Option{"environment",
           [](const Render& m) { return protocol::word(m.environment(), "auto") != "auto"; }},
    Option{"environment_rotate", [](const Render& m) { return m.environment_rotate() != 0; }},
    Option{"sun", [](const Render& m) { return m.sun(); }},
    Option{"noise", [](const Render& m) { return m.noise() != 0; }, true},
    Option{"tonemap", [](const Render& m) { return !protocol::text(m.tonemap()).empty(); }, true},
    Option{"exposure", [](const Render& m) { return !protocol::text(m.exposure()).empty(); }, true},
    Option{"progressive", [](const Render& m) { return m.progressive(); }, true},
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

std::string idle_options_note(const Render& message, std::string_view integrator) {
    // A picture that is continued repeats all options of the one before.
    if (message.resume_bytes() != 0) return {};
    const bool linear = protocol::word(message.encode(), "png") == "exr";
    const auto table = integrator_table();
    const auto found = std::ranges::find(table, integrator, &IntegratorInfo::name);
    const IntegratorInfo* const info = found == table.end() ? nullptr : &*found;
    std::string by_integrator, by_file;
    for (const Option& option : options) {
        if (!option.is_given(message)) continue;
        if (!uses(info, option))
            add(by_integrator, option.name);
        else if (linear && (option.name == "tonemap" || option.name == "exposure"))
            add(by_file, option.name);
    }
    std::string note = note_of("with integrator " + std::string(integrator), by_integrator);
    if (!by_file.empty())
        note.append(note.empty() ? "" : "; ")
            .append(note_of("on an EXR, which is linear", by_file));
    return note;
}

std::string idle_options_note(const wire::Heatmap& message, std::string_view file) {
    if (file == "png") return {};
    std::string colours;
    if (!protocol::text(message.palette()).empty()) add(colours, "palette");
    if (protocol::word(message.scale(), "linear") != "linear") add(colours, "scale");
    return note_of("on counts, which have no colours", colours);
}

std::string idle_options_note(const wire::Job& message, bool hides_nothing) {
    std::string boxes;
    if (hides_nothing && message.skip_hidden_boxes()) add(boxes, "skip_hidden_boxes");
    return note_of("without `hide` or `only`", boxes);
}

}  // namespace raynest::server
