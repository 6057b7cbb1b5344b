defmodule Situ.Store.TermCodecTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Store
  alias Situ.Store.{TermCodec, Undecoded, Writer}
  import Situ.Store.Test.Record, only: [message: 2]

  @moduletag :tmp_dir

  property "every storable term round-trips" do
    forall term <- term() do
      case TermCodec.encode(term) do
        {:ok, bytes} -> TermCodec.decode(bytes) == {:ok, term}
        {:error, {:not_storable, what}} -> is_binary(what)
      end
    end
  end

  property "decodes any bytes without raising, and only to storable terms" do
    forall bytes <- binary() do
      case TermCodec.decode(<<131>> <> bytes) do
        {:ok, term} -> match?({:ok, _}, TermCodec.encode(term))
        {:error, reason} -> is_binary(reason)
      end
    end
  end

  test "processes, references, functions and ports are neither encoded nor decoded" do
    for alive <- [self(), make_ref(), fn -> 1 end, &:erlang.halt/0, hd(Port.list())] do
      assert {:error, {:not_storable, _}} = TermCodec.encode([%{a: {alive}}])
      assert {:error, _} = TermCodec.decode(:erlang.term_to_binary(alive))
    end
  end

  test "refuses compressed terms and terms of many small parts" do
    zeros = :binary.copy(<<0>>, 10_000_000)

    assert {:error, "a compressed term"} =
             TermCodec.decode(:erlang.term_to_binary(zeros, compressed: 9))

    # 6 million elements of one byte each would take 96 MB.
    small = <<131, 108, 6_000_000::32>> <> :binary.copy(<<106>>, 6_000_001)
    assert {:error, "a term that takes more than 64 MiB" <> _} = TermCodec.decode(small)
  end

  test "no stored value is mistaken for a marker of the reader", %{tmp_dir: root} do
    function = :erlang.term_to_binary(&:erlang.halt/1)
    {:ok, writer} = Writer.create("marks", root)
    {:ok, stream} = Writer.stream(writer, "S")

    marks = [
      {:"$situ_unknown", ["Elixir.Situ.Store"], function, %{}},
      {:unknown, ["Elixir.Situ.Store"], function, %{}},
      {:unknown, {["Elixir.Situ.Store"], function, %{}}},
      {:undecodable, "why"},
      {:"$situ_undecodable", %{any: 1}},
      :unknown,
      :undecodable
    ]

    messages = for {mark, i} <- Enum.with_index(marks), do: message(mark, i)
    {:ok, stream} = Writer.append(stream, messages)
    :ok = Writer.put_metadata(stream, hd(marks))
    :ok = Writer.close(writer)
    store = Store.open!(writer.path)
    assert store |> Store.messages("S") |> Enum.map(& &1.data) == marks
    assert Store.metadata(store, "S") == {:ok, hd(marks)}
  end

  test "reads messages a few unpacked megabytes at a time", %{tmp_dir: root} do
    {:ok, writer} = Writer.create("masks", root)
    {:ok, stream} = Writer.stream(writer, "Mask", compression: :zstd, large: true)
    mask = :binary.copy(<<0>>, 2_000_000)
    {:ok, _} = Writer.append(stream, for(i <- 1..40, do: message(mask, i)))
    :ok = Writer.close(writer)
    store = Store.open!(writer.path)
    {:ok, info} = Store.stream_info(store, "Mask")
    assert info.stored < 100_000
    assert {:ok, batch, 3} = Store.Query.read_batch(store, info, 0, :unbounded, 1_000, [])
    assert length(batch) == 3
    assert Enum.count(Store.messages(store, "Mask")) == 40
    # A caller can set a stricter limit for untrusted files.
    strict = Store.open!(writer.path, max_unpacked: 1_000_000)
    assert {:error, %{code: :damaged, why: why}} = Store.at(strict, "Mask", 0)
    assert why =~ "unpacks to more"
  end

  test "a refused term is returned as a value with the reason", %{tmp_dir: root} do
    assert %Undecoded{reason: "a function"} =
             Situ.Store.Test.Raw.decode(root, :erlang.term_to_binary(&:lists.reverse/1))
  end
end
