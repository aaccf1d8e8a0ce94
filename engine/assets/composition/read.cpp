#include "engine/assets/composition/read.h"

#include "engine/assets/composition/read_animation.h"
#include "engine/assets/composition/value.h"
#include "engine/scene/motion/affine.h"
#include "engine/scene/snapshot.h"
#include "engine/shading/types.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <optional>
#include <set>
#include <span>
#include <utility>

namespace raynest::composition {
namespace {

Matrix matrix_of_rows(std::span<const double> rows) {
    Matrix made(1);
    for (int i = 0; i < 12; ++i) made[i % 4][i / 4] = rows[static_cast<std::size_t>(i)];
    return made;
}

/// Rows of 4: 12 or 16 numbers, or 3 or 4 lists of 4.
Matrix read_matrix(const Value& value) {
    std::vector<double> numbers;
    for (const Value& item : value.list()) {
        if (!item.is_list()) {
            numbers.push_back(item.number());
            continue;
        }
        const auto row = item.numbers<4>();
        numbers.insert(numbers.end(), row.begin(), row.end());
    }
    if (numbers.size() != 12 && numbers.size() != 16)
        value.refuse_it("is no matrix of 3 or 4 rows of 4 numbers");
    if (numbers.size() == 16 &&
        !std::ranges::equal(std::array{0.0, 0.0, 0.0, 1.0}, std::span(numbers).subspan(12)))
        value.refuse_it(
            "has a last row that is not 0 0 0 1: rows of a matrix stand one behind the other");
    return matrix_of_rows(numbers);
}

/// Translation, rotation and scale, as glTF has them.
PoseParts read_parts(const Value& place) {
    PoseParts parts;
    if (place.has("rotation")) {
        parts.rotation = place.at("rotation").numbers<4>();
        if (parts.rotation == std::array<double, 4>{})
            place.at("rotation").refuse_it("is a quaternion of length 0");
    }
    if (place.has("scale")) {
        const Value by = place.at("scale");
        parts.scale = by.is_list() ? by.vector() : glm::dvec3(by.number());
    }
    if (place.has("translation")) parts.translation = place.at("translation").vector();
    return parts;
}

Matrix matrix_of_parts(const PoseParts& parts) {
    return matrix_of_rows(from_trs(&parts.translation.x, parts.rotation.data(), &parts.scale.x));
}

/// A matrix, or the parts of one. `more` counts other members that say the same.
std::optional<Matrix> read_pose(const Value& value, bool more = false) {
    const bool is_posed = value.has("translation") || value.has("rotation") || value.has("scale");
    if (int{is_posed} + int{value.has("matrix")} + int{more} > 1)
        value.refuse_it(
            "says twice where it stands: give one of 'matrix', 'matrices', or 'translation' with "
            "'rotation' and 'scale'");
    if (is_posed) return matrix_of_parts(read_parts(value));
    if (value.has("matrix")) return read_matrix(value.at("matrix"));
    return std::nullopt;
}

std::uint32_t read_uid(const Value& value) {
    const std::uint32_t uid = value.bits();
    if (uid == no_id) value.refuse_it("is 4294967295, which stands for no user id");
    return uid;
}

Places read_places(const Value& value) {
    value.only({"object", "name", "translation", "rotation", "scale", "matrix", "matrices", "mask",
                "uid"});
    Places places;
    places.object = value.at("object").text();
    places.name = value.has("name") ? value.at("name").text() : places.object;
    if (places.name.empty()) value.refuse_it("has an empty name");
    const auto pose = read_pose(value, value.has("matrices"));
    if (!value.has("matrices")) {
        places.matrices.push_back(pose.value_or(Matrix(1)));
        if (!value.has("matrix")) places.parts = read_parts(value);
    } else if (const Value matrices = value.at("matrices"); matrices.is_text()) {
        places.table = matrices.text();
    } else {
        for (const Value& matrix : matrices.list()) places.matrices.push_back(read_matrix(matrix));
    }
    if (value.has("mask")) places.mask = value.at("mask").bits();
    if (value.has("uid")) places.uid = read_uid(value.at("uid"));
    return places;
}

/// Reads a change: one word of `raynest edit` with the path that it is about, and what it says.
Change read_change(const Value& value) {
    using What = Change::What;
    struct Word {
        const char* name;
        What what;
        EditFrame frame;
        std::uint32_t value;
        const char* wanted;  ///< a member that must be there; "": none
    };
    constexpr std::array words{
        Word{"move", What::move, EditFrame::world, 0, "matrix"},
        Word{"turn", What::move, EditFrame::own, 0, "matrix"},
        Word{"place", What::place, EditFrame::world, 0, "matrix"},
        Word{"remove", What::remove, EditFrame::world, 0, ""},
        Word{"set-mask", What::set_mask, EditFrame::world, 0, "mask"},
        Word{"set-uid", What::set_uid, EditFrame::world, 0, "uid"},
        Word{"set-material", What::set_material, EditFrame::world, 0, "material"},
        Word{"hide", What::set_mask, EditFrame::world, 0, ""},
        Word{"show", What::set_mask, EditFrame::world, ~0U, ""},
    };
    value.only({"move", "turn", "place", "remove", "set-mask", "set-uid", "set-material", "hide",
                "show", "matrix", "translation", "rotation", "scale", "mask", "uid", "material"});
    const auto is_said = [&](const Word& word) { return value.has(word.name); };
    const auto word = std::ranges::find_if(words, is_said);
    if (word == words.end() || std::ranges::count_if(words, is_said) != 1)
        value.refuse_it(
            "is to have one of move, turn, place, remove, set-mask, set-uid, set-material, hide "
            "and show, with a path");
    Change change{word->what, value.at(word->name).text(), word->frame, Matrix(1), word->value, {}};
    const std::string_view wanted = word->wanted;
    const auto pose = read_pose(value);
    const auto is_right = [&](const char* member) {
        return value.has(member) == (wanted == member);
    };
    if (pose.has_value() != (wanted == "matrix") || !is_right("mask") || !is_right("uid") ||
        !is_right("material"))
        value.refuse_it(fmt::format(
            "is to have {} beside '{}'",
            wanted == "matrix" ? "'matrix', or 'translation' with 'rotation' and 'scale', alone"
            : wanted.empty()   ? "nothing"
                               : fmt::format("'{}' alone", wanted),
            word->name));
    if (pose) change.matrix = *pose;
    if (wanted == "mask") change.value = value.at("mask").bits();
    if (wanted == "uid") change.value = read_uid(value.at("uid"));
    if (wanted == "material") {
        const Value material = value.at("material");
        change.material = material.is_text() ? material.text() : fmt::format("{}", material.bits());
    }
    return change;
}

double positive(const Value& value) {
    const double number = value.number();
    if (!(number > 0)) value.refuse_it("is not above 0");
    return number;
}

UpAxis read_up(const Value& value) {
    const std::string up = value.text();
    if (up != "y" && up != "z") value.refuse_it("is neither \"y\" nor \"z\"");
    return up == "z" ? UpAxis::z : UpAxis::y;
}

Object read_object(const std::string& name, const Value& value) {
    Object object;
    object.name = name;
    if (value
            .only({"file", "unit", "up", "radius", "spacing", "primitive", "origin", "at", "masks",
                   "variant", "mesh", "instances"})
            .has("instances")) {
        value.only({"instances"});
        for (const Value& places : value.at("instances").list())
            object.instances.push_back(read_places(places));
        return object;
    }
    object.source = value.at("file").text();
    if (object.source.empty()) value.at("file").refuse_it("is empty");
    if (value.has("unit")) object.options.unit = positive(value.at("unit"));
    if (value.has("radius")) object.options.radius = positive(value.at("radius"));
    if (value.has("spacing")) object.options.spacing = positive(value.at("spacing"));
    if (value.has("primitive")) object.primitive = value.at("primitive").text();
    if (value.has("variant")) object.variant = value.at("variant").text();
    if (value.has("mesh")) object.mesh = value.at("mesh").text();
    object.has_up = value.has("up");
    if (object.has_up) object.options.z_up = read_up(value.at("up")) == UpAxis::z;
    if (value.has("origin")) {
        object.options.auto_origin = value.at("origin").is_text();
        if (!object.options.auto_origin)
            object.origin = value.at("origin").numbers<3>();
        else if (value.at("origin").text() != "auto")
            value.at("origin").refuse_it("is neither three numbers nor \"auto\"");
    }
    if (value.has("at")) {
        object.at = value.at("at").numbers<3>();
        if (value.has("origin"))
            value.at("at").refuse_it("stands beside an origin: give one of the two");
        if (!is_origin(object.at)) value.at("at").refuse_it("lies beyond 1e15");
    }
    if (value.has("masks"))
        for (const Value& rule : value.at("masks").list()) object.masks.push_back(rule.text());
    return object;
}

Camera read_camera(const Value& value, UpAxis up) {
    value.only({"name", "eye", "target", "up", "fov"});
    Camera camera;
    if (value.has("name")) camera.name = value.at("name").text();
    camera.eye = value.at("eye").vector();
    camera.target = value.at("target").vector();
    camera.up = value.has("up") ? value.at("up").vector() : upwards(up);
    if (value.has("fov")) camera.fov = value.at("fov").number();
    if (!(camera.fov > 0 && camera.fov < 180))
        value.at("fov").refuse_it("is not between 0 and 180 degrees");
    const double sine = glm::length(glm::cross(camera.target - camera.eye, camera.up));
    if (!(sine > 0)) value.refuse_it("looks nowhere, or along its 'up'");
    return camera;
}

/// Brighter lights would make the power of all lights infinite, as in gltf/file/lights.cpp; larger
/// lengths would not fit a float.
constexpr double light_most = 1e30;

double light_number(const Value& value) {
    const double number = value.number();
    if (!(number >= 0 && number <= light_most)) value.refuse_it("is not from 0 to 1e30");
    return number;
}

float cosine_of(const Value& degrees) {
    const double angle = degrees.number();
    if (!(angle >= 0 && angle <= 90)) degrees.refuse_it("is not from 0 to 90 degrees");
    return static_cast<float>(std::cos(angle * std::numbers::pi / 180));
}

Light read_light(const Value& value) {
    std::vector<std::string_view> known{"name",      "type",  "position", "direction", "colour",
                                        "intensity", "range", "inner",    "outer"};
    const std::string type =
        value.has("type") && value.at("type").is_text() ? value.at("type").text() : "";
    const auto kind = light_kind(type);
    // Cones are given as angles.
    std::span<const LightNumber> numbers;
    if (kind && type != "spot") numbers = light_numbers(*kind);
    for (const LightNumber& number : numbers) known.emplace_back(number.name);
    value.only(known);
    Light light;
    if (value.has("name")) light.name = value.at("name").text();
    static_cast<void>(value.at("type").text());
    if (!kind)
        value.at("type").refuse_it(
            fmt::format("'{}' is none of {}", one_line(type, 60), light_names()));
    const bool is_spot = type == "spot";
    // A distant light has no place, and a point no direction.
    if (type == "directional" ? value.has("position") : type == "point" && value.has("direction"))
        value.refuse_it(type == "point" ? "is a point and has a 'direction'"
                                        : "is directional and has a 'position'");
    if (!is_spot && (value.has("inner") || value.has("outer")))
        value.refuse_it("has a cone and is no spot");
    LightRecord& record = light.record;
    set_kind(record, *kind);
    if (type != "directional") light.position = value.at("position").vector();
    for (int i = 0; i < 3; ++i)
        if (!(std::abs(light.position[i]) <= double{coordinate_max}))
            value.at("position").refuse_it("is beyond 1e15");
    if (type != "point") {
        const glm::dvec3 direction = value.at("direction").vector();
        const double largest =
            std::max({std::abs(direction.x), std::abs(direction.y), std::abs(direction.z)});
        if (!(largest > 0)) value.at("direction").refuse_it("is no direction");
        record.direction = Vec3(glm::normalize(direction / largest));
    }
    const double intensity = value.has("intensity") ? light_number(value.at("intensity")) : 1;
    record.intensity = Vec3(static_cast<float>(intensity));
    if (value.has("colour")) {
        const Value colour = value.at("colour");
        const glm::dvec3 rgb = colour.vector();
        for (int i = 0; i < 3; ++i) {
            if (!(rgb[i] >= 0 && rgb[i] * intensity <= light_most))
                colour.refuse_it("is negative or too bright");
            record.intensity[i] = static_cast<float>(rgb[i] * intensity);
        }
    }
    if (value.has("range")) record.range = static_cast<float>(light_number(value.at("range")));
    for (const LightNumber& number : numbers) {
        if (!value.has(number.name)) continue;
        const auto given = static_cast<float>(value.at(number.name).number());
        if (!(given >= number.least && given <= number.most))
            value.at(number.name)
                .refuse_it(fmt::format("is not from {:g} to {:g}", number.least, number.most));
        *light_number(record, number.name) = given;
    }
    if (is_spot) {
        if (value.has("inner")) record.own[0] = cosine_of(value.at("inner"));
        if (value.has("outer")) record.own[1] = cosine_of(value.at("outer"));
        if (!(record.own[1] <= record.own[0]))
            value.refuse_it("has an 'inner' cone that is wider than the 'outer' one");
    }
    return light;
}

/// Refuses what is nested too deep, and members that an object has twice. The parser's own callback
/// would look at all of a list after each of its elements.
class Watch : public nlohmann::json_sax<Json> {
public:
    explicit Watch(const ImportLimits& limits) : limits_(limits) {}
    bool null() override { return true; }
    bool boolean(bool) override { return true; }
    bool number_integer(number_integer_t) override { return true; }
    bool number_unsigned(number_unsigned_t) override { return true; }
    bool number_float(number_float_t, const string_t&) override { return true; }
    bool string(string_t&) override { return true; }
    bool binary(binary_t&) override { return true; }
    bool start_object(std::size_t) override {
        keys_.emplace_back();
        return enter();
    }
    bool key(string_t& name) override {
        if (!keys_.back().insert(name).second)
            refuse(fmt::format("has the member '{}' twice in one object", one_line(name)));
        return true;
    }
    bool end_object() override {
        keys_.pop_back();
        return leave();
    }
    bool start_array(std::size_t) override { return enter(); }
    bool end_array() override { return leave(); }
    /// The parser that makes the values says what is wrong.
    bool parse_error(std::size_t, const std::string&, const nlohmann::detail::exception&) override {
        return false;
    }

private:
    bool enter() {
        if (++depth_ > limits_.json_depth_max)
            refuse(fmt::format("is nested deeper than {} levels", limits_.json_depth_max));
        return true;
    }
    bool leave() {
        --depth_;
        return true;
    }

    const ImportLimits& limits_;
    std::uint64_t depth_ = 0;
    std::vector<std::set<std::string>> keys_;
};

/// Parses the text, and refuses nesting beyond the limit and members that are there twice.
Json parse(std::string_view text, const ImportLimits& limits) {
    Watch watch(limits);
    Json::sax_parse(text, &watch);
    try {
        return Json::parse(text);
    } catch (const Json::parse_error& error) {
        refuse(fmt::format("is not valid JSON (byte {})", error.byte));
    } catch (const Json::out_of_range&) {
        refuse("has a number that is beyond 1e308");
    }
}

/// Refuses instances of objects that are not there.
void check_objects(const Composition& made, const ImportLimits& limits) {
    std::set<std::string_view> known;
    for (std::size_t i = 0; i + 1 < made.objects.size(); ++i) known.insert(made.objects[i].name);
    std::uint64_t places = 0;
    for (const Object& object : made.objects)
        for (const Places& at : object.instances) {
            places += at.matrices.size();
            if (known.contains(at.object)) continue;
            std::string list;
            for (const std::string_view name : known)
                list += fmt::format("{}'{}'", list.empty() ? "" : ", ", name);
            refuse(fmt::format("places '{}', which is none of its objects: {}", one_line(at.object),
                               one_line(list)));
        }
    if (places > limits.nodes_max)
        refuse(fmt::format("has {} instances; at most {} are allowed, and more in a .npy of "
                           "matrices",
                           places, limits.nodes_max),
               ErrorCode::limit_exceeded);
}

}  // namespace

Result<Composition> read(std::string_view text, const ImportLimits& limits) try {
    if (text.size() > limits.json_bytes_max)
        refuse(fmt::format("has {} bytes; at most {} are read", text.size(), limits.json_bytes_max),
               ErrorCode::limit_exceeded);
    const Json json = parse(text, limits);
    const Value root(json, "");
    if (!json.is_object() || !json.contains("rnscene"))
        refuse("has no member 'rnscene': a composition begins with {\"rnscene\": 1, ...}");
    root.only({"$schema", "rnscene", "origin", "up", "objects", "instances", "cameras", "lights",
               "animations", "edits"});
    if (root.at("rnscene").number() != 1)
        refuse("is of another version: this RayNest reads \"rnscene\": 1");
    Composition made;
    if (root.has("origin")) made.origin = root.at("origin").numbers<3>();
    if (root.has("up")) made.up = read_up(root.at("up"));
    root.at("objects").each_member([&](const std::string& name, const Value& value) {
        made.objects.push_back(read_object(name, value));
    });
    Object& scene = made.objects.emplace_back();
    scene.name = "scene";
    for (const Value& places : root.at("instances").list())
        scene.instances.push_back(read_places(places));
    if (root.has("cameras"))
        for (const Value& camera : root.at("cameras").list())
            made.cameras.push_back(read_camera(camera, made.up));
    if (root.has("lights"))
        for (const Value& light : root.at("lights").list())
            made.lights.push_back(read_light(light));
    if (root.has("animations"))
        for (const Value& animation : root.at("animations").list())
            made.animations.push_back(read_animation(animation));
    if (root.has("edits"))
        for (const Value& change : root.at("edits").list())
            made.edits.push_back(read_change(change));
    check_objects(made, limits);
    return made;
} catch (const Refusal& refusal) {
    return tl::unexpected<Error>(refusal.error);
}

}  // namespace raynest::composition
