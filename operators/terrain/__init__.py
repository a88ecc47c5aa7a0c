# SPDX-License-Identifier: GPL-3.0-or-later
"""A terrain object: settings of its detail, the request made from them, updates, frozen detail and its panel."""
