// A private daemon for one command: `--local`.
#pragma once

#include "client/ground/child_process.h"
#include "client/net/temporary_folder.h"

#include <string>
#include <utility>

namespace raynest::client {

/// Tells the program that this process becomes which raynestd it is to start, by RAYNESTD, unless that is set: the one beside
/// this program, else the one on PATH.
void name_daemon();

/// A raynestd that listens on a Unix socket in a temporary folder, which only its user can open. It
/// ends with this object, and with this process whatever ends that.
class LocalDaemon {
public:
    /// Starts the raynestd beside this program, else the one on PATH, and waits until it serves
    /// requests. Exit code 3 where there is none or it does not start. Call it from the main
    /// thread.
    static Result<LocalDaemon> start();

    [[nodiscard]] std::string uri() const { return "unix:" + (folder_.path() / "socket").string(); }
    /// The folder of the socket, for a program that this process becomes: it must do what hide() does.
    [[nodiscard]] std::string folder() const { return folder_.path().string(); }
    /// Removes the folder once the client is connected, so that nothing stays behind even where
    /// this process is killed. Nobody can connect after that.
    void hide() { folder_.remove(); }

private:
    LocalDaemon(TemporaryFolder folder, ChildProcess process)
        : folder_(std::move(folder)),
          process_(std::move(process)) {}
    Result<void> await_ready();

    TemporaryFolder folder_;  ///< goes after the process, which has files in it
    ChildProcess process_;
};

}  // namespace raynest::client
