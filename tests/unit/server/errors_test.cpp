#include "server/ground/errors.h"

#include <doctest/doctest.h>

namespace raynest::server {
namespace {

TEST_CASE("a module that does not load is named to the client, without its folder") {
    const auto told =
        to_wire({ErrorCode::pack_invalid, "cannot load /usr/lib/a.so: it is cut short"});
    CHECK(told.code == Code::file_unusable);
    CHECK(for_client(told).message == "cannot load a.so: it is cut short");
}

TEST_CASE("errors that a user can repair never read as defects of the daemon") {
    for (const ErrorCode code :
         {ErrorCode::scene_invalid, ErrorCode::scene_unsupported, ErrorCode::limit_exceeded,
          ErrorCode::variant_unknown, ErrorCode::param_invalid, ErrorCode::field_invalid,
          ErrorCode::out_of_memory, ErrorCode::io_failed})
        CHECK(to_wire({code, "m"}).code != Code::internal);
    CHECK(to_wire({ErrorCode::internal, "m"}).code == Code::internal);
    CHECK(to_wire({ErrorCode::scene_invalid, "the message"}).message == "the message");
}

TEST_CASE("the command line's exit code follows from the engine's error") {
    const auto exit_of = [](ErrorCode code) {
        return protocol::error_info(to_wire({code, ""}).code).exit;
    };
    CHECK(exit_of(ErrorCode::scene_invalid) == protocol::Exit::invalid);
    CHECK(exit_of(ErrorCode::scene_unsupported) == protocol::Exit::invalid);
    CHECK(exit_of(ErrorCode::variant_unknown) == protocol::Exit::invalid);
    CHECK(exit_of(ErrorCode::param_invalid) == protocol::Exit::usage);
    CHECK(exit_of(ErrorCode::field_invalid) == protocol::Exit::usage);
    CHECK(exit_of(ErrorCode::out_of_memory) == protocol::Exit::busy);
    CHECK(exit_of(ErrorCode::io_failed) == protocol::Exit::busy);
}

}  // namespace
}  // namespace raynest::server
