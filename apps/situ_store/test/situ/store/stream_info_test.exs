defmodule Situ.Store.StreamInfoTest do
  use ExUnit.Case, async: true
  alias Situ.Store.StreamInfo

  test "computes rates and means of the recorded messages, and nil without messages" do
    info = %StreamInfo{
      id: 1,
      name: "S",
      count: 11,
      first: 1_000_000_000,
      last: 6_000_000_000,
      size: 220,
      latency_sum: 55
    }

    assert StreamInfo.message_rate(info) == 2.0
    assert StreamInfo.average_size(info) == 20.0
    assert StreamInfo.average_latency(info) == 5.0
    assert StreamInfo.duration(info) == 5_000_000_000
    refute StreamInfo.closed?(info)
    assert StreamInfo.closed?(%{info | closed: 0})

    one = %{info | count: 1, last: info.first}
    assert StreamInfo.message_rate(one) == nil and StreamInfo.duration(one) == 0
    none = %StreamInfo{id: 1, name: "S"}
    assert StreamInfo.message_rate(none) == nil and StreamInfo.duration(none) == 0
    assert StreamInfo.average_size(none) == nil and StreamInfo.average_latency(none) == nil
  end

  test "metadata is plain data, whatever the file contains" do
    info = %StreamInfo{id: 1, name: "S"}
    assert {:error, %{code: :no_metadata}} = StreamInfo.metadata(info)
    with_term = fn bytes -> %{info | supplemental: {":any", bytes}} end

    assert StreamInfo.metadata(with_term.(:erlang.term_to_binary(%{"u" => "m"}))) ==
             {:ok, %{"u" => "m"}}

    bomb = :erlang.term_to_binary(:binary.copy("x", 100_000), compressed: 9)

    for bytes <- [
          :erlang.term_to_binary(&length/1),
          :erlang.term_to_binary(self()),
          bomb,
          "",
          <<131>>
        ],
        do: assert({:error, %{code: :damaged}} = StreamInfo.metadata(with_term.(bytes)))
  end
end
