defmodule Situ.JsonLogTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  doctest Situ.JsonLog

  @time {{2026, 1, 2}, {3, 4, 5, 6}}

  property "any message and metadata become one line of JSON" do
    forall {text, value} <- {binary(), binary()} do
      metadata = [time: 1_000, pipeline: value, state: {self(), value}, pid: self()]
      line = IO.iodata_to_binary(Situ.JsonLog.format(:info, inspect(text), @time, metadata))
      assert [json, ""] = String.split(line, "\n")
      assert {:ok, %{"level" => "info", "message" => message} = fields} = Situ.JSON.decode(json)
      assert message == inspect(text)
      assert Map.keys(fields) == ~w(level message pipeline state time)
    end
  end

  test "a line without the time of the logger has the local time" do
    assert IO.iodata_to_binary(Situ.JsonLog.format(:warning, ["a", ?b], @time, [])) ==
             ~s({"time":"2026-01-02T03:04:05.006","level":"warning","message":"ab"}\n)
  end

  test "a message that is not text is reported, and does not raise" do
    assert Situ.JsonLog.format(:info, [<<255>>, :atom], @time, []) =~
             "could not format a log line"
  end
end
