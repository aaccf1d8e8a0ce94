// The parts of the daemon that requests and jobs may use.
#pragma once

#include "engine/assets/input/import_request.h"
#include "protocol/limits.h"
#include "server/execution/backend.h"

#include <filesystem>
#include <string>
#include <vector>

namespace raynest {
class Registry;
}

namespace raynest::server {

class Admission;
class Budget;
class ChangeGate;
class DetachedJobs;
class FairThreadPool;
class KeptSelections;
class Peers;
class SceneStore;
class ScenePoser;
class SceneWaker;
class StateFolder;
struct Metrics;
class Administration;
class PageLogins;
class TraceBufferPool;

/// The parts of the daemon that handlers may use. One per daemon; outlives all jobs.
struct Services {
    const Registry& registry;
    SceneStore& scenes;  ///< io thread only
    Budget& budget;
    Metrics& metrics;
    const protocol::Limits& limits;
    ImportLimits import_limits;
    std::filesystem::path scene_root;       ///< empty: root:PATH is refused
    std::vector<std::string> import_child;  ///< command line of the import process
    Admission& admission;
    DetachedJobs& detached;
    Peers& peers;  ///< io thread only
    const Backends& backends;
    TraceBufferPool& trace_buffers;
    FairThreadPool& blocking;                  ///< for tasks that wait for processes and disks
    std::string page = {};                     ///< address of the daemon's page; empty: none
    Administration* administration = nullptr;  ///< null in tests without a whole daemon
    PageLogins* page_logins = nullptr;         ///< null likewise
    StateFolder* state = nullptr;              ///< null: scenes are in memory only
    SceneWaker* waker = nullptr;               ///< null likewise
    ChangeGate* changes = nullptr;             ///< null likewise
    /// Null likewise; for short tasks of it that no import may hold up
    FairThreadPool* disk = nullptr;
    ScenePoser* poser = nullptr;           ///< null in tests without a whole daemon
    KeptSelections* selections = nullptr;  ///< null likewise
};

}  // namespace raynest::server
