defmodule Situ.Remote.Link.HandshakeTest do
  use ExUnit.Case, async: true
  doctest Situ.Remote.Link.Handshake
end
