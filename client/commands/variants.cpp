// raynest variants: the compiled intersectors, their parameters and outputs.
#include "client/commands/command.h"
#include "client/ground/json.h"
#include "client/ground/text.h"
#include "client/output/output.h"
#include "client/requests/listings.h"

#include <cmath>
#include <cstdint>
#include <iostream>

namespace raynest::client {
namespace {

struct VariantsOptions {};

Json param_json(const wire::Param& param) {
    Json json{{"name", protocol::text(param.name())},
              {"type", protocol::text(param.type())},
              {"text", protocol::text(param.text())}};
    const std::vector<std::string> choices = protocol::strings(param.choices());
    if (choices.empty()) {
        json["minimum"] = param.minimum();
        json["maximum"] = param.maximum();
        json["default"] = json["type"] == "table" ? Json::array() : Json(param.initial());
        return json;
    }
    json["choices"] = choices;
    // The index may be any number; one that is out of range means that there is no default.
    const double initial = param.initial();
    if (initial >= 0 && initial < static_cast<double>(choices.size()))
        json["default"] = choices[static_cast<std::size_t>(initial)];
    return json;
}

Json variant_json(const wire::Variant& variant) {
    Json json{{"name", protocol::text(variant.name())},
              {"text", protocol::text(variant.text())},
              {"target", protocol::text(variant.target())},
              {"targets", protocol::strings(variant.targets())},
              {"queries", protocol::strings(variant.queries())},
              {"params", Json::array()},
              {"outputs", Json::array()}};
    if (variant.params() != nullptr)
        for (const wire::Param* param : *variant.params())
            json["params"].push_back(param_json(*param));
    if (variant.outputs() != nullptr)
        for (const wire::Output* output : *variant.outputs())
            json["outputs"].push_back(Json{{"name", protocol::text(output->name())},
                                           {"type", protocol::text(output->type())},
                                           {"text", protocol::text(output->text())}});
    return json;
}

std::string joined(const Json& list) {
    std::string line;
    for (const Json& item : list) line += (line.empty() ? "" : " ") + item.get<std::string>();
    return line;
}

/// Returns a number as 0.001, not as 0.0010000000474974513; whole numbers in full.
std::string number_text(const Json& number) {
    const double value = number.is_number() ? number.get<double>() : 0;
    if (std::floor(value) == value && std::abs(value) < 1e15)
        return std::to_string(static_cast<std::int64_t>(value));
    return float_text(static_cast<float>(value));
}

/// "0..1  (0.5)", "heart checker  (heart)", or of a table "@FILE  (each 0..1)".
std::string values_text(const Json& param) {
    if (param.contains("choices"))
        return joined(param["choices"]) + "  (" + param.value("default", "0") + ")";
    const std::string range = number_text(param["minimum"]) + ".." + number_text(param["maximum"]);
    if (param["type"] == "table") return "@FILE  (each " + range + ")";
    return range + "  (" + number_text(param.value("default", Json())) + ")";
}

void print_variant(const Json& variant) {
    std::cout << variant["name"].get<std::string>() << "  (" << joined(variant["queries"]) << "; "
              << joined(variant["targets"]) << ", runs on " << variant["target"].get<std::string>()
              << ")\n    " << variant["text"].get<std::string>() << '\n';
    for (const Json& param : variant["params"])
        std::cout << "    --set " << param["name"].get<std::string>() << "=" << values_text(param)
                  << "  " << param["text"].get<std::string>() << '\n';
    for (const Json& output : variant["outputs"])
        std::cout << "    --fields " << output["name"].get<std::string>() << "  "
                  << output["text"].get<std::string>() << '\n';
}

}  // namespace

void declare(CommandLine&, VariantsOptions&) {}

Result<void> run(Context& context, const VariantsOptions&) {
    Json all = Json::array();
    wire::VariantsT request;
    for (bool more = true; more;) {
        const auto page = ask<wire::VariantList>(context.connection, request);
        if (!page) return tl::unexpected<Failure>(page.error());
        const auto* variants = (*page)->variants();
        const std::uint32_t count = variants != nullptr ? variants->size() : 0;
        if (auto fits = check_listed(all.size() + count); !fits) return fits;
        for (std::uint32_t i = 0; i < count; ++i) all.push_back(variant_json(*variants->Get(i)));
        request.first += count;
        more = count != 0 && request.first < (*page)->total();
    }
    if (context.json) {
        print_json(Json{{"variants", all}});
    } else {
        for (const Json& variant : all) print_variant(variant);
    }
    return {};
}

std::unique_ptr<Command> make_variants() {
    return make_command<VariantsOptions>();
}

}  // namespace raynest::client
