defmodule Situ.TelemetryTest do
  use ExUnit.Case, async: true
  doctest Situ.Telemetry
end
