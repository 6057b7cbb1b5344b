defmodule Situ.OptionsTest do
  use ExUnit.Case, async: true
  doctest Situ.Options
end
