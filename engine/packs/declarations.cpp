#include "engine/packs/declarations.h"

#include "engine/packs/registry.h"
#include "engine/queries/columns.h"

#include <algorithm>
#include <set>
#include <span>
#include <string>
#include <string_view>

namespace raynest {
namespace {

bool is_letter(char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || c == '_';
}

/// True for what a user can write before a `=` and between commas.
bool is_word(const char* name) {
    if (name == nullptr || !is_letter(*name)) return false;
    const std::string_view text(name);
    return std::all_of(text.begin(), text.end(),
                       [](char c) { return is_letter(c) || (c >= '0' && c <= '9'); });
}

bool is_common_param(std::string_view name) {
    const auto common = common_params();
    return std::any_of(common.begin(), common.end(),
                       [&](const PackParam& param) { return param.name == name; });
}

/// Names of one kind, each of which may be added once.
class Names {
public:
    explicit Names(std::string kind) : kind_(std::move(kind)) {}

    /// Returns what is wrong with a name, or "".
    std::string complaint(const char* name) {
        if (!is_word(name))
            return kind_ + " '" + (name == nullptr ? "" : name) +
                   "' is no word: use letters, digits and _, a letter first";
        return known_.insert(name).second ? "" : kind_ + " '" + name + "' is declared twice";
    }

private:
    std::string kind_;
    std::set<std::string_view> known_;
};

std::string complaint_about_values(const PackParam& param) {
    const std::string name = "parameter '" + std::string(param.name) + "'";
    if (param.type != value_choice)
        return param.minimum <= param.maximum
                   ? ""
                   : name + " has its minimum above its maximum: exchange them";
    if (param.choice_count == 0) return name + " has no choices";
    Names choices("choice of " + name + ",");
    for (std::uint32_t i = 0; i < param.choice_count; ++i) {
        if (auto why = choices.complaint(param.choices[i]); !why.empty()) return why;
    }
    return {};
}

std::string complaint(const PackVariant& variant) {
    Names params("parameter");
    for (const PackParam& param : std::span(variant.params, variant.param_count)) {
        if (auto why = params.complaint(param.name); !why.empty()) return why;
        if (is_common_param(param.name))
            return "parameter '" + std::string(param.name) +
                   "' is one that every intersector has: rename it";
        if (auto why = complaint_about_values(param); !why.empty()) return why;
    }
    Names outputs("output");
    for (const PackOutput& output : std::span(variant.outputs, variant.output_count)) {
        if (auto why = outputs.complaint(output.name); !why.empty()) return why;
        if (parse_column(output.name) || output.name == splits_column)
            return "output '" + std::string(output.name) +
                   "' is named like a column of every query: rename it";
    }
    return {};
}

}  // namespace

Result<void> check_declarations(const Pack& pack, const std::filesystem::path& file) {
    const auto refuse = [&](const std::string& why) {
        return fail(ErrorCode::pack_invalid, file.string() + ": " + why);
    };
    Names primitives("primitive");
    for (const PackPrimitive& primitive : std::span(pack.primitives, pack.primitive_count)) {
        if (const auto why = primitives.complaint(primitive.name); !why.empty()) return refuse(why);
    }
    for (const PackVariant& variant : std::span(pack.variants, pack.variant_count)) {
        if (const auto why = complaint(variant); !why.empty())
            return refuse("intersector '" + std::string(variant.name) + "': " + why);
    }
    return {};
}

}  // namespace raynest
