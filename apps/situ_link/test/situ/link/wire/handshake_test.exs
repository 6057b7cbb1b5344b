defmodule Situ.Link.Wire.HandshakeTest do
  use ExUnit.Case, async: true
  doctest Situ.Link.Wire.Handshake
end
