defmodule Situ.Remote.Link.ScheduleTest do
  use ExUnit.Case, async: true
  doctest Situ.Remote.Link.Schedule
end
