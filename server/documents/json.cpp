#include "server/documents/json.h"

#include "engine/queries/columns.h"

#include <array>
#include <charconv>
#include <cmath>
#include <cstddef>

namespace raynest::server {

Json number(float value) {
    if (!std::isfinite(value)) return nullptr;
    std::array<char, 32> text{};
    const auto written = std::to_chars(text.data(), text.data() + text.size(), value);
    double read = 0;
    std::from_chars(text.data(), written.ptr, read);
    return read;
}

Json world_point(const Vec3& point, const WorldPoint& origin) {
    Json json = Json::array();
    for (int axis = 0; axis < 3; ++axis) {
        const double shift = origin[static_cast<std::size_t>(axis)];
        if (shift == 0)
            json.push_back(number(point[axis]));
        else
            json.push_back(shift + double{point[axis]});
    }
    return json;
}

Json world_box(const Box& box, const WorldPoint& origin) {
    if (box.is_empty()) return nullptr;
    return Json::array({world_point(box.lower, origin), world_point(box.upper, origin)});
}

Json counters_json(const Counters& counters) {
    Json json = Json::object();
    ColumnSource source;
    source.counters = {&counters, 1};
    for (const FieldInfo& info : counter_table()) {
        const auto field = parse_field(info.name);
        std::uint32_t count = 0;
        write_column(*field, source, reinterpret_cast<std::byte*>(&count));
        json[std::string(info.name)] = count;
    }
    return json;
}

std::string text_of(const Json& document) {
    return document.dump(-1, ' ', false, Json::error_handler_t::replace);
}

}  // namespace raynest::server
