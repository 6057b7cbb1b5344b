defmodule Situ.Python.Protocol do
  @moduledoc false
  # Encodes and decodes the frames between a component and its Python worker (`clients/python/src/situ/worker.py`).
  # Pure. The socket adds a length of 32 bits to each frame. Numbers are little-endian.
  #
  # | to Python | fields |
  # |---|---|
  # | `S` start | a term: the component, its options, inputs and outputs |
  # | `M` messages | for each: input (8 bits), originating time, creation time, sequence id (64 bits each), place |
  # | `R` return | the numbers of output slots that have been read (32 bits each) |
  # | `C` close | the time at which the last input has closed |
  # | `K` snapshot | |
  # | `V` restore | the bytes of the value that a snapshot returned |
  #
  # | from Python | fields |
  # |---|---|
  # | `O` ready | the process id (32 bits), the version of Python |
  # | `E` not started | a term: code, what, why, fix |
  # | `T` results | the time that Python has spent on them (ns, 64 bits), and one for each message, in order |
  # | `L` return | the numbers of input slots that are no longer in use |
  # | `D` closed | the result of `on_close` |
  # | `K` reply | the result of `K` or `V`: one emission with the state, or none |
  #
  # A place is 0, a length (32 bits) and bytes; or 1, the number of a slot (32 bits), its offset, its capacity and the
  # length of the value (64 bits each). `Situ.Store.ValueCodec` encodes the bytes.
  #
  # A result is 0, the number of emissions (16 bits), and for each the output (8 bits), the time (64 bits) and a place;
  # or 1, the text of an exception and a proposal to fix it, both with a length (32 bits); or 2, if a generator has
  # ended.
  #
  # Everything from Python is untrusted: it never becomes an atom or code.
  alias Situ.Store.{TermCodec, ValueCodec}

  @typedoc "The place of a value: its bytes, or a slot of the shared memory."
  @type place :: {:bytes, binary()} | {:slot, slot()}
  @type slot :: %{
          number: non_neg_integer(),
          offset: non_neg_integer(),
          capacity: pos_integer(),
          length: pos_integer()
        }
  @type emission :: {output :: non_neg_integer(), Situ.Time.t(), place()}
  @type result :: {:ok, [emission()]} | :finished | {:raised, text :: binary(), fix :: binary()}
  @type frame ::
          {:ready, process :: non_neg_integer(), version :: binary()}
          | {:not_started, term :: map()}
          | {:results, [result()], spent_ns :: non_neg_integer()}
          | {:returned, [non_neg_integer()]}
          | {:closed, result()}
          | {:reply, result()}

  @doc "Encodes the first frame. Returns `:error` if an option is not plain data."
  @spec encode_start(map()) :: {:ok, iodata()} | :error
  def encode_start(term) do
    case TermCodec.encode(term) do
      {:ok, bytes} -> {:ok, ["S", bytes]}
      {:error, _} -> :error
    end
  end

  @doc "Encodes a value. Returns `:error` if it is not plain data."
  @spec encode_value(term()) :: {:ok, iodata()} | :error
  # Numbers and binaries need no check. Bytes 131 and 70 begin a float in the external term format, 131 and 98 an
  # integer, 131 and 109 a binary.
  def encode_value(value) when is_float(value), do: {:ok, <<0, 131, 70, value::float-64>>}

  def encode_value(value) when is_integer(value) and value in 0x100..0x7FFFFFFF,
    do: {:ok, <<0, 131, 98, value::signed-32>>}

  def encode_value(value) when is_integer(value),
    do: {:ok, [0, :erlang.term_to_binary(value)]}

  # A binary needs no copy.
  def encode_value(value) when is_binary(value),
    do: {:ok, [<<0, 131, 109, byte_size(value)::32>>, value]}

  def encode_value(value), do: ValueCodec.encode(value)

  @doc "Encodes the fields of a message before its place."
  @spec encode_head(input :: 0..255, Situ.Message.t()) :: binary()
  def encode_head(input, message) do
    <<input, message.originating_time::little-signed-64, message.creation_time::little-signed-64,
      message.sequence_id::little-64>>
  end

  @doc """
  Encodes a place.

      iex> Situ.Python.Protocol.encode_place({:bytes, "ab"}) |> IO.iodata_to_binary()
      <<0, 2, 0, 0, 0, "ab">>
  """
  @spec encode_place({:bytes, iodata()} | {:slot, slot()}) :: iodata()
  def encode_place({:bytes, bytes}), do: [<<0, IO.iodata_length(bytes)::little-32>>, bytes]

  def encode_place({:slot, slot}) do
    <<1, slot.number::little-32, slot.offset::little-64, slot.capacity::little-64,
      slot.length::little-64>>
  end

  @spec encode_messages(iodata()) :: iodata()
  def encode_messages(messages), do: ["M", messages]

  @spec encode_return([non_neg_integer()]) :: iodata()
  def encode_return(slots), do: ["R", for(slot <- slots, do: <<slot::little-32>>)]

  @spec encode_close(Situ.Time.t()) :: iodata()
  def encode_close(time), do: ["C", <<time::little-signed-64>>]

  @spec encode_snapshot() :: iodata()
  def encode_snapshot, do: "K"

  @spec encode_restore(binary()) :: iodata()
  def encode_restore(value), do: ["V", value]

  @doc """
  Decodes a frame from Python; returns `:error` for invalid frames.

      iex> Situ.Python.Protocol.decode_frame(<<"L", 3, 0, 0, 0>>)
      {:ok, {:returned, [3]}}
      iex> Situ.Python.Protocol.decode_frame("nonsense")
      :error
  """
  @spec decode_frame(binary()) :: {:ok, frame()} | :error
  def decode_frame(<<"T", spent_ns::little-64, results::binary>>) do
    with {:ok, results} <- decode_results(results, []), do: {:ok, {:results, results, spent_ns}}
  end

  def decode_frame(<<"L", slots::binary>>) when rem(byte_size(slots), 4) == 0,
    do: {:ok, {:returned, for(<<slot::little-32 <- slots>>, do: slot)}}

  def decode_frame(<<"O", process::little-32, version::binary>>),
    do: {:ok, {:ready, process, version}}

  def decode_frame(<<"D", result::binary>>), do: decode_single(:closed, result)
  def decode_frame(<<"K", result::binary>>), do: decode_single(:reply, result)

  def decode_frame(<<"E", term::binary>>) do
    case TermCodec.decode(term) do
      {:ok, %{"what" => what} = term} when is_binary(what) -> {:ok, {:not_started, term}}
      _ -> :error
    end
  end

  def decode_frame(_frame), do: :error

  defp decode_single(kind, bytes) do
    case decode_results(bytes, []) do
      {:ok, [result]} -> {:ok, {kind, result}}
      _ -> :error
    end
  end

  defp decode_results(<<>>, results), do: {:ok, Enum.reverse(results)}

  defp decode_results(<<2, rest::binary>>, results),
    do: decode_results(rest, [:finished | results])

  defp decode_results(<<0, count::little-16, rest::binary>>, results) do
    with {:ok, emissions, rest} <- decode_emissions(count, rest, []),
         do: decode_results(rest, [{:ok, emissions} | results])
  end

  defp decode_results(
         <<1, n::little-32, text::binary-size(n), m::little-32, fix::binary-size(m),
           rest::binary>>,
         results
       ),
       do: decode_results(rest, [{:raised, text, fix} | results])

  defp decode_results(_bytes, _results), do: :error

  defp decode_emissions(0, rest, emissions), do: {:ok, Enum.reverse(emissions), rest}

  defp decode_emissions(
         count,
         <<output, time::little-signed-64, 0, n::little-32, bytes::binary-size(n), rest::binary>>,
         emissions
       ),
       do: decode_emissions(count - 1, rest, [{output, time, {:bytes, bytes}} | emissions])

  defp decode_emissions(
         count,
         <<output, time::little-signed-64, 1, number::little-32, offset::little-64,
           capacity::little-64, length::little-64, rest::binary>>,
         emissions
       ) do
    slot = %{number: number, offset: offset, capacity: capacity, length: length}
    decode_emissions(count - 1, rest, [{output, time, {:slot, slot}} | emissions])
  end

  defp decode_emissions(_count, _bytes, _emissions), do: :error

  @doc "Decodes results without a frame, as in the journal."
  @spec decode_results(binary()) :: {:ok, [result()]} | :error
  def decode_results(bytes), do: decode_results(bytes, [])

  @doc "Decodes the bytes of a value. The error describes them."
  @spec decode_value(binary()) :: {:ok, term()} | {:error, String.t()}
  def decode_value(<<0, 131, 70, value::float-64>>), do: {:ok, value}
  def decode_value(<<0, 131, 98, value::signed-32>>), do: {:ok, value}
  def decode_value(bytes), do: ValueCodec.decode(bytes)
end
