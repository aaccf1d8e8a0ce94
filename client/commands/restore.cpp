// raynest restore FILE: scenes of a backup come back.
#include "client/commands/command.h"
#include "client/files/files.h"
#include "client/ground/descriptor.h"
#include "client/ground/json.h"
#include "client/output/output.h"
#include "client/requests/picture.h"
#include "client/requests/send_file.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <iostream>

namespace raynest::client {
namespace {

struct RestoreOptions {
    std::string file;
    std::vector<std::string> scenes;  ///< OWNER/NAME; empty: all
};

Result<void> read_at(const Descriptor& file, const std::string& name, std::uint64_t offset,
                     std::span<std::byte> into) {
    while (!into.empty()) {
        const ssize_t done =
            ::pread(file.number(), into.data(), into.size(), static_cast<off_t>(offset));
        if (done < 0 && errno == EINTR) continue;
        if (done <= 0)
            return fail(Exit::invalid, name + ": " +
                                           (done == 0 ? "the file was cut while it was read"
                                                      : std::strerror(errno)));
        into = into.subspan(static_cast<std::size_t>(done));
        offset += static_cast<std::uint64_t>(done);
    }
    return {};
}

void print_scenes(const Json& report) {
    const auto print = [&](const char* key, const char* text) {
        for (const Json& name : report.value(key, Json::array()))
            if (name.is_string()) std::cout << name.get<std::string>() << text << '\n';
    };
    print("restored", " is back");
    print("mended", " was damaged and is whole again");
    print("kept", " stays as it is here: to have the backup's, unload it, then restore it");
    print("missing", " is damaged in the backup");
}

}  // namespace

void declare(CommandLine& line, RestoreOptions& options) {
    line.add_option("FILE", options.file,
                    "what raynest backup has written. A scene whose name is in use stays as it is "
                    "there, unless it is damaged")
        .required();
    line.add_options("SCENE", options.scenes, "OWNER/NAME of scenes that come back (default: all)");
}

Result<void> run(Context& context, const RestoreOptions& options) {
    const Descriptor file(::open(options.file.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK));
    struct stat found {};
    if (!file || ::fstat(file.number(), &found) != 0)
        return fail(Exit::invalid, options.file + ": " + std::strerror(errno));
    if (!S_ISREG(found.st_mode))
        return fail(Exit::invalid, options.file + " is no file; name what raynest backup wrote");
    wire::RestoreT request;
    request.bytes = static_cast<std::uint64_t>(found.st_size);
    request.scenes = options.scenes;
    if (auto started = context.connection.start(request); !started)
        return tl::unexpected<Failure>(started.error());
    const auto read = [&](std::uint64_t offset, std::span<std::byte> into) {
        return read_at(file, options.file, offset, into);
    };
    const FrameConsumer ignore = [](const protocol::Frame&) { return Result<void>(); };
    if (auto sent = send_file(context.connection, 0, request.bytes, read, context.progress, ignore);
        !sent)
        return sent;
    const auto answer = receive_file(context.connection, context.progress, document_room());
    context.progress.clear();
    if (!answer) return tl::unexpected<Failure>(answer.error());
    const auto report = read_json(*answer);
    if (!report) return tl::unexpected<Failure>(report.error());
    if (context.json)
        print_json(*report);
    else
        print_scenes(*report);
    return {};
}

std::unique_ptr<Command> make_restore() {
    return make_command<RestoreOptions>();
}

}  // namespace raynest::client
