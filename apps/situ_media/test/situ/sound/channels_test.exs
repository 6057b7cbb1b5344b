defmodule Situ.Sound.ChannelsTest do
  use ExUnit.Case, async: true
  doctest Situ.Sound.Channels
end
