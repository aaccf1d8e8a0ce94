// Tests that a pack with names or ranges that no request could use is refused, and that tables are
// checked.
#include "engine/packs/declarations.h"

#include "engine/packs/registry.h"

#include <doctest/doctest.h>

#include <array>
#include <limits>
#include <string>
#include <vector>

using namespace raynest;

namespace {

constexpr PackParam number(const char* name, double minimum = 0, double maximum = 1) {
    return {name, "", value_f32, 0, nullptr, minimum, maximum, 0};
}

std::string complaint(std::vector<PackParam> params, std::vector<PackOutput> outputs = {},
                      std::vector<PackPrimitive> primitives = {}) {
    PackVariant variant{};
    variant.name = "mine";
    variant.params = params.data();
    variant.param_count = static_cast<std::uint32_t>(params.size());
    variant.outputs = outputs.data();
    variant.output_count = static_cast<std::uint32_t>(outputs.size());
    Pack pack{};
    pack.variants = &variant;
    pack.variant_count = 1;
    pack.primitives = primitives.data();
    pack.primitive_count = static_cast<std::uint32_t>(primitives.size());
    const auto checked = check_declarations(pack, "my_pack.so");
    if (checked) return "";
    CHECK(checked.error().code == ErrorCode::pack_invalid);
    return checked.error().message;
}

}  // namespace

TEST_CASE("a pack is refused by file and intersector for a parameter that no request could set") {
    CHECK(complaint({number("height"), number("width")}) == "");
    const std::string mine = "my_pack.so: intersector 'mine': ";
    CHECK(complaint({number("cull")}) ==
          mine + "parameter 'cull' is one that every intersector has: rename it");
    CHECK(complaint({number("a"), number("b"), number("a")}) ==
          mine + "parameter 'a' is declared twice");
    CHECK(complaint({number("a", 5, 2)}) ==
          mine + "parameter 'a' has its minimum above its maximum: exchange them");
    CHECK(complaint({number("a", std::numeric_limits<double>::quiet_NaN(), 2)}) != "");
    for (const char* bad : {"", "a=b", "a b", "1st", "gr\xc3\xb6sse"})
        CHECK(complaint({number(bad)}) ==
              mine + "parameter '" + bad +
                  "' is no word: use letters, digits and _, a letter first");
    const std::array<const char*, 2> twice{"on", "on"};
    PackParam choice{"mode", "", value_choice, 2, twice.data(), 0, 1, 0};
    CHECK(complaint({choice}) == mine + "choice of parameter 'mode', 'on' is declared twice");
    choice.choice_count = 0;
    CHECK(complaint({choice}) == mine + "parameter 'mode' has no choices");
}

TEST_CASE("a pack is refused for an output that is named like a column, or twice") {
    CHECK(complaint({}, {{"passed", "", value_u32}}) == "");
    for (const char* column : {"t", "path", "total", "prim_hits", "ray_splits"}) {
        CAPTURE(column);
        CHECK(complaint({}, {{column, "", value_u32}}) ==
              "my_pack.so: intersector 'mine': output '" + std::string(column) +
                  "' is named like a column of every query: rename it");
    }
    CHECK(complaint({}, {{"a", "", value_u32}, {"a", "", value_f32}}) ==
          "my_pack.so: intersector 'mine': output 'a' is declared twice");
    CHECK(complaint({}, {}, {{"disc", 4, 1, nullptr, nullptr}, {"disc", 4, 1, nullptr, nullptr}}) ==
          "my_pack.so: primitive 'disc' is declared twice");
}

TEST_CASE("the registry refuses such a pack by its file") {
    const auto odd = Registry::load({{RAYNEST_TEST_ODD_NAME_PACK}, "auto"});
    REQUIRE(!odd);
    CHECK(odd.error().message.find("odd_name_pack") != std::string::npos);
    CHECK(odd.error().message.find("output 'path' is named like a column") != std::string::npos);
}

TEST_CASE("tables are checked by name, kind, range and number of values") {
    const std::array<PackParam, 3> params{number("height"),
                                          PackParam{"curve", "", value_table, 0, nullptr, 0, 1, 0},
                                          PackParam{"ids", "", value_table, 0, nullptr, 0, 1e6, 0}};
    PackVariant code{};
    code.params = params.data();
    code.param_count = params.size();
    Variant variant;
    variant.code = &code;
    variant.name = "mine";
    const auto parse = [&](std::vector<NamedTable> tables) {
        return parse_settings(variant, {}, tables);
    };

    const auto none = parse({});
    REQUIRE(none.has_value());
    CHECK(none->tables == nullptr);
    const auto ids = parse({{"ids", {3, 7}}});
    REQUIRE(ids.has_value());
    TraceCall call{};
    ids->apply_to(call);
    CHECK(call.tables[0].count == 0);
    REQUIRE(call.tables[1].count == 2);
    CHECK(call.tables[1][1] == 7);
    CHECK(*ids == *parse({{"ids", {3, 7}}}));
    CHECK_FALSE(*ids == *parse({{"ids", {3, 8}}}));
    CHECK_FALSE(*ids == *none);

    const auto refused = [&](std::vector<NamedTable> tables) {
        const auto settings = parse(std::move(tables));
        return settings ? std::string() : settings.error().message;
    };
    CHECK(refused({{"curve", {0, 1.5F}}}) ==
          "value 1 of table 'curve' is 1.5: use a number from 0 to 1 for each");
    CHECK(refused({{"curve", {std::numeric_limits<float>::quiet_NaN()}}}) ==
          "value 0 of table 'curve' is nan: use a number from 0 to 1 for each");
    CHECK(refused({{"height", {1}}}) == "'height' is no table: use a number from 0 to 1");
    CHECK(refused({{"curve", {1}}, {"curve", {0}}}) == "table 'curve' comes twice");
    CHECK(refused({{"bend", {1}}}) ==
          "intersector 'mine' has no parameter 'bend'; it has: cull, height, curve, ids");
    CHECK(refused({{"curve", std::vector<float>(table_values_max)}, {"ids", {1}}}) ==
          "the tables have 8193 values, over table_values_max = 8192");
    const std::vector<std::pair<std::string, std::string>> as_number{{"curve", "0.5"}};
    CHECK(parse_settings(variant, as_number).error().message ==
          "'curve' is a table: bring its values from a file or an array");
}
