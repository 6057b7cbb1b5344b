defmodule Situ.CoreDocTest do
  use ExUnit.Case, async: true
  doctest Situ.Error
  doctest Situ.JSON
  doctest Situ.Options
  doctest Situ.Time
  doctest Situ.Message
  doctest Situ.Telemetry
end
