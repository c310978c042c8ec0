"""The contract between the supervisor and whatever moves the machines.

`keys` names the channels, `types` the messages, `codec` their bytes, `session` the
connection, `reader` the newest value with its age.
"""
