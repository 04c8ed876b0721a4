// SPDX-License-Identifier: AGPL-3.0-or-later
// A room without sources yet still makes a library.
