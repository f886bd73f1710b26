// Whether a client fits a server.
#include <sstream>

#include "graspd/client.hpp"

namespace graspd {

namespace {

struct Series {
  int major = -1;
  int minor = -1;
};

Series series(const std::string& version) {
  Series found;
  char dot = 0;
  std::istringstream text(version);
  if (!(text >> found.major >> dot >> found.minor) || dot != '.') return {};
  return found;
}

}  // namespace

void check_version(const std::string& client, const std::string& server) {
  const Series ours = series(client), theirs = series(server);
  const bool same = ours.major == theirs.major && ours.minor == theirs.minor;
  const bool older = ours.major > 0 && ours.major == theirs.major && ours.minor < theirs.minor;
  if (theirs.major >= 0 && (same || older)) return;
  throw Error(grpc::StatusCode::FAILED_PRECONDITION, "VERSION_MISMATCH",
              "this client is graspd " + client + " and the server is " + (server.empty() ? "of unknown version" : server) +
                  ": build the client from the server's release, or update the server");
}

}  // namespace graspd
