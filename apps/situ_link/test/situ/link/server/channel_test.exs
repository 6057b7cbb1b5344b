defmodule Situ.Link.Server.ChannelTest do
  use ExUnit.Case, async: true
  alias Situ.Link.Server.Channel

  @good %{"name" => "imu", "from" => "start", "window" => 1_000}

  test "accepts valid requests of a client" do
    assert {:ok, %{name: "imu", from: :start, credit: 1_000, priority: 0}} = Channel.new(1, @good)
    assert {:ok, %{from: {:after, 7}}} = Channel.new(1, %{@good | "from" => %{"after" => 7}})

    assert {:ok, %{policy: %{max_queue: 3}}} =
             Channel.new(1, Map.put(@good, "policy", %{"max_queue" => 3}))

    assert {:ok, %{priority: -4}} = Channel.new(1, Map.put(@good, "priority", -4))
  end

  test "returns a sentence for an invalid request" do
    for wrong <- [
          %{},
          %{@good | "name" => 5},
          %{@good | "from" => "later"},
          %{@good | "from" => %{"at" => 1.5}},
          %{@good | "from" => %{"after" => 0x8000000000000000}},
          %{@good | "window" => 0},
          %{@good | "window" => nil},
          Map.put(@good, "priority", 1_000),
          Map.put(@good, "policy", "loud"),
          Map.put(@good, "policy", %{"max_latency" => "1 s"})
        ] do
      assert {:error, why} = Channel.new(1, wrong)
      assert is_binary(why)
    end
  end
end
