#include "client/files/npy.h"

#include "client/requests/rays.h"
#include "tests/temporary_folder.h"

#include <doctest/doctest.h>

#include <cmath>
#include <limits>
#include <string>
#include <vector>

using namespace raynest;
using client::Array;

namespace {

bool is_point(const wire::Vec3& point, float x, float y, float z) {
    return point.x() == x && point.y() == y && point.z() == z;
}

std::vector<std::byte> bytes_of(const std::string& text) {
    const auto* data = reinterpret_cast<const std::byte*>(text.data());
    return {data, data + text.size()};
}

/// Returns a version 1 .npy with this header text and data.
std::vector<std::byte> npy(const std::string& header, const std::string& data) {
    std::string text = "\x93NUMPY";
    text += '\x01';
    text += '\0';
    text += static_cast<char>(header.size() & 0xFF);
    text += static_cast<char>(header.size() >> 8);
    return bytes_of(text + header + data);
}

std::string header_of(const std::string& descr, const std::string& order,
                      const std::string& shape) {
    return "{'descr': '" + descr + "', 'fortran_order': " + order + ", 'shape': " + shape + ", }\n";
}

void write_rays(const test::TemporaryFolder& folder, const Array& array) {
    const std::vector<std::byte> file = client::format_npy(array);
    folder.write("rays.npy", {reinterpret_cast<const char*>(file.data()), file.size()});
}

}  // namespace

TEST_CASE("written arrays read back") {
    const std::vector<std::byte> data(96);
    for (const Array& array : {Array{"<f4", {3, 8}, data}, Array{"<f8", {12}, data},
                               Array{"|u1", {96}, data}, Array{"<u8", {1, 2, 6}, data}}) {
        const std::vector<std::byte> file = client::format_npy(array);
        CHECK((file.size() - data.size()) % 64 == 0);
        const auto read = client::parse_npy(file);
        REQUIRE(read);
        CHECK(read->dtype == array.dtype);
        CHECK(read->shape == array.shape);
        CHECK(read->bytes.size() == data.size());
    }
}

TEST_CASE("the header is NumPy's own") {
    const std::vector<std::byte> data(8);
    const std::vector<std::byte> file = client::format_npy({"<u4", {2}, data});
    const std::string text(reinterpret_cast<const char*>(file.data()), 128);
    CHECK(text.substr(10, 58) == "{'descr': '<u4', 'fortran_order': False, 'shape': (2,), } ");
    CHECK(text[127] == '\n');
}

TEST_CASE("files other than arrays of numbers are refused") {
    const std::string eight(8, 'x');
    CHECK(client::parse_npy(npy(header_of("<f4", "False", "(2,)"), eight)));
    CHECK(client::parse_npy(npy(header_of("<f8", "False", "()"), eight)));
    for (const auto& file :
         {bytes_of(""),
          bytes_of("PK\x03\x04........"),
          bytes_of("\x93NUMPY\x01"),
          npy(header_of("|O", "False", "(2,)"), eight),
          npy(header_of("<U2", "False", "(1,)"), eight),
          npy(header_of("<c8", "False", "(1,)"), eight),
          npy(header_of("<f3", "False", "(1,)"), eight),
          npy(header_of("<u16", "False", "(1,)"), eight),
          npy(header_of("", "False", "(1,)"), eight),
          npy("{'descr': [('a', '<f4')], 'fortran_order': False, 'shape': (2,)}", eight),
          npy("{'descr': '<f4, 'fortran_order': False, 'shape': (2,)}", eight),
          npy("{'fortran_order': False, 'shape': (2,), 'descr': '", eight),
          npy(header_of("<f4", "False", "(3,)"), eight),
          npy(header_of("<f4", "False", "(2,"), eight),
          npy(header_of("<f4", "False", "2"), eight),
          npy(header_of("<f4", "False", "(-2,)"), eight),
          npy(header_of("<f4", "False", "(4611686018427387906,)"), eight),
          npy(header_of("<f4", "False", "(18446744073709551615, 2)"), eight),
          npy(header_of("<f4", "False", "(1,1,1,1,1,1,1,1,2)"), eight),
          npy("{}", eight),
          npy("", eight)}) {
        const auto read = client::parse_npy(file);
        REQUIRE(!read);
        CHECK(read.error().exit == protocol::Exit::invalid);
    }
}

TEST_CASE("rows are read in either order and byte order, rounded to float32") {
    const auto rows_of = [](const std::string& descr, const std::string& order,
                            const std::string& data) {
        const std::vector<std::byte> file = npy(header_of(descr, order, "(2, 2)"), data);
        const auto array = client::parse_npy(file);
        REQUIRE(array);
        std::vector<float> rows(2);
        client::read_rows(*array, 1, rows);
        return rows;
    };
    using Rows = std::vector<float>;
    CHECK(rows_of("|u1", "False", {1, 2, 3, -1}) == Rows{3, 255});
    CHECK(rows_of("|i1", "True", {1, 2, 3, -1}) == Rows{2, -1});
    CHECK(rows_of(">i2", "False", {0, 1, 0, 2, 1, 0, -1, -2}) == Rows{256, -2});
    CHECK(rows_of("<u2", "False", {0, 1, 0, 2, 1, 0, -1, -1}) == Rows{1, 65535});
    // Float16: 1.5, the smallest number, the largest, minus infinity.
    CHECK(rows_of(">f2", "False", {0x3E, 0, 0, 1, 0x7B, -1, -4, 0}) ==
          Rows{65504, -std::numeric_limits<float>::infinity()});
    CHECK(rows_of(">f2", "True", {0x3E, 0, 0, 1, 0x7B, -1, -4, 0}) ==
          Rows{0x1p-24F, -std::numeric_limits<float>::infinity()});
    CHECK(std::isnan(rows_of("<f2", "False", {0, 0, 0, 0, 1, 0x7C, 0, -0x80})[0]));
    CHECK(std::signbit(rows_of("<f2", "False", {0, 0, 0, 0, 1, 0x7C, 0, -0x80})[1]));
}

TEST_CASE("CRC-32 is ZIP's") {
    CHECK(client::crc32(bytes_of("123456789")) == 0xCBF43926U);
    CHECK(client::crc32({}) == 0);
}

TEST_CASE("an archive ends with a directory of its members") {
    const std::vector<std::byte> data(8);
    const std::vector<client::NamedArray> arrays = {{"t", {"<f4", {2}, data}},
                                                    {"path", {"<u8", {1}, data}}};
    const std::vector<std::byte> zip = client::format_npz(arrays);
    const std::string text(reinterpret_cast<const char*>(zip.data()), zip.size());
    CHECK(text.substr(0, 4) == "PK\x03\x04");
    CHECK(text.substr(zip.size() - 22, 4) == "PK\x05\x06");
    CHECK(text.find("t.npy") != std::string::npos);
    CHECK(text.find("path.npy") != std::string::npos);
    CHECK(text.find("PK\x06\x06") != std::string::npos);
}

TEST_CASE("the scene's origin is subtracted from ray origins before digits are lost") {
    const test::TemporaryFolder folder;
    const client::WorldPoint origin = {500'000, 4'500'000, 100};
    std::vector<float> out(6);
    const std::vector<double> exact = {500'000.015625, 4'500'000.015625, 101, 0, 0, -1};
    write_rays(folder, {"<f8", {1, 6}, std::as_bytes(std::span(exact))});
    auto rays = client::RaySource::open(folder.file("rays.npy"), std::nullopt, origin);
    REQUIRE(rays);
    rays->read(0, out);
    CHECK(out == std::vector<float>{0.015625F, 0.015625F, 1, 0, 0, -1});

    const std::vector<float> narrow = {500'000.5F, 4'500'000, 101, 0, 0, -1};
    write_rays(folder, {"<f4", {1, 6}, std::as_bytes(std::span(narrow))});
    rays = client::RaySource::open(folder.file("rays.npy"), std::nullopt, origin);
    REQUIRE(rays);
    CHECK(rays->bytes(0, 1).empty());
    rays->read(0, out);
    CHECK(out == std::vector<float>{0.5F, 0, 1, 0, 0, -1});

    const std::vector<float> ways = {0, 0, -1};
    write_rays(folder, {"<f4", {1, 3}, std::as_bytes(std::span(ways))});
    rays = client::RaySource::open(folder.file("rays.npy"),
                                   client::WorldPoint{500'001, 4'500'002, 103}, origin);
    REQUIRE(rays);
    CHECK(is_point(*rays->common_origin(), 1, 2, 3));
    CHECK(rays->bytes(0, 1).size() == 12);
}

TEST_CASE("rays are read from float32 and float64, six or eight to a row") {
    const test::TemporaryFolder folder;
    const std::vector<float> six = {1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12};
    write_rays(folder, {"<f4", {2, 6}, std::as_bytes(std::span(six))});
    auto rays = client::RaySource::open(folder.file("rays.npy"), std::nullopt);
    REQUIRE(rays);
    REQUIRE(rays->count() == 2);
    REQUIRE(rays->width() == 6);
    std::vector<float> out(6);
    rays->read(1, out);
    CHECK(out == std::vector<float>{7, 8, 9, 10, 11, 12});
    CHECK(rays->bytes(1, 1).size() == 24);

    const std::vector<double> eight = {1, 2, 3, 0.5, 5, 6, 7, 100};
    write_rays(folder, {"<f8", {1, 8}, std::as_bytes(std::span(eight))});
    rays = client::RaySource::open(folder.file("rays.npy"), std::nullopt);
    REQUIRE(rays);
    out.resize(rays->width());
    rays->read(0, out);
    CHECK(out == std::vector<float>{1, 2, 3, 0.5F, 5, 6, 7, 100});
    CHECK(rays->bytes(0, 1).empty());

    const client::WorldPoint from = {1, 2, 3};
    CHECK(!client::RaySource::open(folder.file("rays.npy"), from));
    write_rays(folder, {"<f4", {4, 3}, std::as_bytes(std::span(six))});
    rays = client::RaySource::open(folder.file("rays.npy"), from);
    REQUIRE(rays);
    CHECK(rays->count() == 4);
    CHECK(rays->width() == 3);
    REQUIRE(rays->common_origin());
    CHECK(is_point(*rays->common_origin(), 1, 2, 3));

    for (const Array& bad : {Array{"<f4", {12}, std::as_bytes(std::span(six))},
                             Array{"<f4", {4, 3}, std::as_bytes(std::span(six))},
                             Array{"<f4", {2, 3, 2}, std::as_bytes(std::span(six))}}) {
        write_rays(folder, bad);
        CHECK(!client::RaySource::open(folder.file("rays.npy"), std::nullopt));
        CHECK(!client::RaySource::open_points(folder.file("rays.npy")));
    }
    for (const Array& none : {Array{"<f4", {0, 6}, {}}, Array{"<f8", {0}, {}}}) {
        write_rays(folder, none);
        CHECK(client::RaySource::open(folder.file("rays.npy"), std::nullopt)->count() == 0);
    }
    write_rays(folder, {"<f4", {6}, std::as_bytes(std::span(six)).first(24)});
    CHECK(client::RaySource::open(folder.file("rays.npy"), std::nullopt)->count() == 1);
}
