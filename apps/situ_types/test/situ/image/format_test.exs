defmodule Situ.Image.FormatTest do
  use ExUnit.Case, async: true
  doctest Situ.Image.Format
end
