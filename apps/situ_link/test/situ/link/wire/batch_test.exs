defmodule Situ.Link.Wire.BatchTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.{Image, Message}
  alias Situ.Link.Wire.Batch
  alias Situ.Store.Undecoded
  doctest Batch

  defp gray(n) do
    Image.new!(width: n, height: 2, format: :gray8, data: :binary.copy(<<n>>, 2 * n))
  end

  # Plain data of every kind that a store accepts.
  defp data do
    simple =
      one_of([integer(), float(), ascii_text(), boolean(), binary(), constant(nil), constant(:ok)])

    image = map(integer(1, 4), &gray/1)
    large = map(integer(500, 600), &:binary.copy("x", &1))
    one_of([simple, large, image, {simple, simple}, list(simple), map(simple, &%{"key" => &1})])
  end

  defp messages do
    map(list({data(), integer(1, 1_000)}), fn items ->
      {messages, _} =
        Enum.map_reduce(items, {0, 0}, fn {data, step}, {time, id} ->
          {time, id} = {time + step, id + 1}

          {%Message{data: data, originating_time: time, creation_time: time + 5, sequence_id: id},
           {time, id}}
        end)

      messages
    end)
  end

  property "messages survive a round trip in order, and the frames describe them" do
    forall messages <- messages() do
      parts = Batch.encode(messages)

      read =
        for {first, last, count, payload} <- parts do
          {:ok, read} = payload |> IO.iodata_to_binary() |> Batch.decode()
          assert length(read) == count
          assert hd(read).originating_time == first
          assert List.last(read).originating_time == last
          read
        end

      assert Enum.concat(read) == messages
    end
  end

  property "a truncated or changed payload gives messages or a readable error", numtests: 300 do
    forall {messages, at, byte} <- {messages(), integer(0, 400), integer(0, 255)} do
      for {_, _, _, payload} <- Batch.encode(messages) do
        bytes = IO.iodata_to_binary(payload)
        at = rem(at, byte_size(bytes))
        <<before::binary-size(at), _, rest::binary>> = bytes

        for broken <- [before, <<before::binary, byte, rest::binary>>] do
          case Batch.decode(broken) do
            {:ok, read} -> assert Enum.all?(read, &is_struct(&1, Message))
            {:error, why} -> assert is_binary(why)
          end
        end
      end
    end
  end

  test "unknown atoms and structs become text and maps, and functions are rejected" do
    term = fn bytes -> Batch.decode(<<0, bytes::binary>>) end

    atom =
      <<131, 108, 0, 0, 0, 1, 104, 4, 97, 1, 97, 2, 97, 3, 119, 21, "never_heard_of_it_here",
        106>>

    assert {:ok, [%{data: text}]} = term.(String.replace(atom, <<119, 21>>, <<119, 22>>))
    assert text == "never_heard_of_it_here"

    fun = :erlang.term_to_binary([{1, 2, 3, &String.length/1}])
    assert {:error, _} = term.(fun)
  end

  test "an unknown codec gives undecoded data, and the stream continues" do
    record = <<1::64, 10::64, 11::64, 3::32, "abc">>

    assert {:ok, [%{data: %Undecoded{bytes: "abc"}}]} =
             Batch.decode(<<4, "what", record::binary>>)

    assert {:error, _} = Batch.decode(<<1, 255, record::binary>>)
  end

  test "large binaries are parts of the payload, not copies" do
    message = %Message{data: :binary.copy("x", 100_000), originating_time: 1, sequence_id: 1}
    [{_, _, 1, payload}] = Batch.encode([message])
    bytes = IO.iodata_to_binary(payload)
    {:ok, [%{data: data}]} = Batch.decode(bytes)
    assert :binary.referenced_byte_size(data) == byte_size(bytes)
  end

  test "separates data that may not be sent" do
    messages = for data <- [1, self(), "a"], do: %Message{data: data, originating_time: 1}
    assert {[%{data: 1}, %{data: "a"}], 1} = Batch.split_encodable(messages)
    assert {[_], 0} = Batch.split_encodable([hd(messages)])
  end
end
