// VARIANTS: lists all intersectors with their parameters and outputs, a page at a time.
#include "protocol/text.h"
#include "server/documents/scene_info.h"
#include "server/requests/request.h"

#include <algorithm>
#include <functional>
#include <map>
#include <string>
#include <vector>

namespace raynest::server {
namespace {

/// Maximum tables and bytes of text of a page, below the limits of a message; a variant is not
/// split between pages.
constexpr std::size_t page_tables = 128;
constexpr std::size_t variants_text_bytes = 24 << 10;

// Kernels and the protocol must have the same limits of hits per ray.
static_assert(multi_hits_max == protocol::Limits{}.hits_max);
static_assert(all_hits_max == protocol::Limits{}.all_hits_max);
static_assert(table_values_max == protocol::Limits{}.table_values_max);

const char* type_name(ValueType type) {
    switch (type) {
        case value_f32:
            return "f32";
        case value_u32:
            return "u32";
        case value_choice:
            return "choice";
        case value_table:
            return "table";
    }
    return "f32";
}

std::vector<std::string> compiled_queries(const PackVariant& code) {
    std::vector<std::string> queries;
    for (std::uint32_t query = 0; query < query_count; ++query)
        if (code.trace[traversal_single][query][0] != nullptr)
            queries.emplace_back(query_name(static_cast<Query>(query)));
    return queries;
}

/// The description of a variant, and its tables and bytes of text.
struct Described {
    wire::VariantT variant;
    std::size_t tables = 1;
    std::size_t text_bytes = 0;
};

/// The names of variants, by backend.
using Kernels = std::map<std::string, std::vector<std::string>, std::less<>>;

Described describe(const Variant& variant, const Kernels& kernels, const protocol::Limits& limits) {
    Described described;
    const auto name = [&](std::string_view text) {
        described.text_bytes += text.size() + 16;
        return protocol::clean_text(text, limits.name_bytes_max);
    };
    const auto prose = [&](std::string_view text) {
        described.text_bytes += text.size() + 16;
        return protocol::clean_text(text, limits.text_bytes_max);
    };
    wire::VariantT& to = described.variant;
    to.name = name(variant.name);
    to.text = prose(variant.text);
    to.target = name(variant.target);
    to.targets = variant.targets;
    for (const auto& [backend, names] : kernels)
        if (std::find(names.begin(), names.end(), variant.name) != names.end())
            to.targets.push_back(backend);
    to.queries = compiled_queries(*variant.code);
    std::vector<PackParam> params(variant.params().begin(), variant.params().end());
    params.insert(params.end(), common_params().begin(), common_params().end());
    for (const PackParam& param : params) {
        auto copy = std::make_unique<wire::ParamT>();
        copy->name = name(param.name);
        copy->text = prose(param.text);
        copy->type = type_name(param.type);
        for (std::uint32_t i = 0; i < param.choice_count; ++i)
            copy->choices.push_back(name(param.choices[i]));
        copy->minimum = param.minimum;
        copy->maximum = param.maximum;
        copy->initial = param.initial;
        to.params.push_back(std::move(copy));
    }
    for (const PackOutput& output : variant.outputs()) {
        auto copy = std::make_unique<wire::OutputT>();
        copy->name = name(output.name);
        copy->text = prose(output.text);
        copy->type = type_name(output.type);
        to.outputs.push_back(std::move(copy));
    }
    described.tables += to.params.size() + to.outputs.size();
    return described;
}

}  // namespace

Reply<Answer> variants(const Services& services, const Caller& caller,
                       const protocol::Opened<wire::Variants>& message) {
    const auto all = services.registry.variants();
    const std::size_t first = std::min<std::size_t>(message->first(), all.size());
    wire::VariantListT list;
    list.first = static_cast<std::uint32_t>(first);
    list.total = static_cast<std::uint32_t>(all.size());
    Kernels kernels;  // asked once: a worker may start or end between two variants
    for (const auto& backend : services.backends)
        kernels.emplace(backend->name(), backend->kernels());
    std::size_t tables = 0;
    std::size_t text_bytes = 0;
    for (std::size_t i = first; i < all.size(); ++i) {
        Described described = describe(all[i], kernels, services.limits);
        tables += described.tables;
        text_bytes += described.text_bytes;
        const bool full = tables > page_tables || text_bytes > variants_text_bytes;
        if (full && !list.variants.empty()) break;
        list.variants.push_back(std::make_unique<wire::VariantT>(std::move(described.variant)));
    }
    return answer_with(caller, list, services);
}

}  // namespace raynest::server
