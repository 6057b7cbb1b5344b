defmodule Situ.Link.Wire.ScheduleTest do
  use ExUnit.Case, async: true
  doctest Situ.Link.Wire.Schedule
end
