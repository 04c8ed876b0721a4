// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <string>

namespace shellgrid {

// Outputs that appear together. From its making on, whatever `write_atomically` has written and synced keeps its
// temporary name until `publish`; without it, all of that is removed and every file is left as it was. One at a time in
// a process.
class OutputSet {
 public:
  OutputSet();
  ~OutputSet();
  OutputSet(const OutputSet&) = delete;
  OutputSet& operator=(const OutputSet&) = delete;

  // Renames all, in the order in which they were written. Throws: InputError where the system refuses a rename; those
  // before it have been renamed then.
  void publish();

  // Where the bytes of an output lie now: under its temporary name where it is still to appear, else under its own.
  static std::string present_path(const std::string& path);

  // As long as one lives, what is written in this thread appears at once: states to go on from.
  class Aside {
   public:
    Aside();
    ~Aside();
    Aside(const Aside&) = delete;
    Aside& operator=(const Aside&) = delete;
  };
};

}  // namespace shellgrid
