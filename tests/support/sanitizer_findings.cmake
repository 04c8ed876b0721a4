# SPDX-License-Identifier: AGPL-3.0-or-later
# Fails and prints what the sanitizers reported into the folder FINDINGS. Reports of allocations too big to be granted
# are no findings: a child that reads a damaged file may end so, and any other program that did has failed its own test.
file(GLOB reports ${FINDINGS}/report*)
set(count 0)
foreach(report ${reports})
  file(READ ${report} text)
  if(NOT text MATCHES "allocation-size-too-big")
    math(EXPR count "${count} + 1")
    message(NOTICE "${report}:\n${text}")
  endif()
endforeach()
if(count)
  message(FATAL_ERROR "${count} sanitizer reports")
endif()
