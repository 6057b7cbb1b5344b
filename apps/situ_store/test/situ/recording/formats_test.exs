defmodule Situ.Recording.FormatsTest do
  use ExUnit.Case, async: true
  doctest Situ.Recording
  doctest Situ.Recording.CodedVideo
  doctest Situ.Recording.Formats
end
