# The client of Situ's own tests, which writes HTTP and WebSockets by hand.
Code.require_file("../../../apps/situ_live/test/support/raw.ex", __DIR__)
Code.require_file("support.exs", __DIR__)
ExUnit.start()
