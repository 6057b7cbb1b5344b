defmodule Situ.Studio.Table do
  @moduledoc """
  Messages of streams as rows of CSV (RFC 4180), and sound as a WAV file: what people take out of a selection.

      iex> message = %Situ.Message{data: "say \\"hi\\"", originating_time: 1_500_000_000, creation_time: 1_500_000_000}
      iex> Situ.Studio.Table.row("Speech", message)
      ~s(1500000000,1970-01-01T00:00:01.500000000Z,Speech,"say ""hi\"""\\r\\n)
  """
  alias Situ.Studio.{Sound, Source}

  # Read in pages, so that memory does not grow with what is asked for.
  @page 2_000
  @second 1_000_000_000
  @stretch 10 * @second

  @doc "The rows of streams between two times, a header first, as chunks of text."
  @spec csv(Source.t(), [String.t()], Situ.Time.t(), Situ.Time.t()) :: Enumerable.t()
  def csv(source, streams, from, to) do
    rows = Stream.flat_map(streams, &pages(source, &1, from, to))
    Stream.concat(["time_ns,time,stream,value\r\n"], rows)
  end

  defp pages(source, stream, from, to),
    do: source |> messages(stream, from, to) |> Stream.map(&rows(stream, &1))

  defp messages(source, stream, from, to) do
    Stream.unfold(from, fn
      nil ->
        nil

      at ->
        case Source.call(source, :messages, [stream, at, to, @page]) do
          {:ok, messages, more} -> {messages, next(messages, more)}
          {:error, _} -> nil
        end
    end)
  end

  @doc """
  The same rows as a Parquet file at `path`, `{:ok, rows}`: the times, `stream`, and `value` or a column for each member
  of maps and structs (`Situ.Bridge.Parquet`). Streams of pictures and sound are left out; where nothing else is asked
  for, that is the error `:no_table`.
  """
  @spec parquet(Source.t(), [String.t()], Situ.Time.t(), Situ.Time.t(), Path.t()) ::
          {:ok, non_neg_integer()} | {:error, Situ.Error.t()}
  def parquet(source, streams, from, to, path) do
    case Enum.filter(streams, &table?(source, &1, to)) do
      [] ->
        {:error,
         Situ.Error.new(:no_table, "pictures and sound are not put into tables",
           fix: "take numbers, states or texts; sound goes to WAV"
         )}

      some ->
        parts =
          Stream.flat_map(some, fn stream ->
            source |> messages(stream, from, to) |> Stream.map(&named(&1, stream))
          end)

        Situ.Bridge.Parquet.write_messages(parts, path, compression: :gzip)
    end
  end

  defp named(messages, stream),
    do: for(m <- messages, do: %{m | data: %{"stream" => stream, "value" => m.data}})

  defp table?(source, stream, to) do
    case Source.call(source, :latest_at, [stream, to]) do
      {:ok, %{data: %module{}}} -> not Situ.Codec.implemented_by?(module)
      {:ok, _} -> true
      _ -> false
    end
  end

  defp next([_ | _] = messages, :more), do: List.last(messages).originating_time + 1
  defp next(_, _), do: nil

  defp rows(stream, messages), do: messages |> Enum.map(&row(stream, &1)) |> IO.iodata_to_binary()

  @doc "One row: time in ns and as a date, stream, value. Other values become JSON, or their size."
  @spec row(String.t(), Situ.Message.t()) :: String.t()
  def row(stream, %Situ.Message{originating_time: time, data: data}) do
    fields = [Integer.to_string(time), Situ.Time.to_iso8601(time), stream, value(data)]
    Enum.map_join(fields, ",", &field/1) <> "\r\n"
  end

  defp value(data) when is_number(data), do: to_string(data)
  defp value(data) when is_boolean(data), do: to_string(data)
  defp value(nil), do: ""
  defp value(data) when is_atom(data), do: Atom.to_string(data)
  defp value(data) when is_binary(data), do: if(String.valid?(data), do: data, else: size(data))

  defp value(data) do
    Situ.JSON.encode(data)
  rescue
    # pictures, sound and the like have no place in a table
    _ -> inspect(data, limit: 20, printable_limit: 200)
  end

  defp size(data), do: "#{byte_size(data)} bytes"

  # A text that a table program would run as a formula is quoted by an apostrophe; numbers stay numbers.
  defp field(<<c, _::binary>> = text) when c in ~c"=+-@" do
    if match?({_, ""}, Float.parse(text)), do: text, else: quoted("'" <> text)
  end

  defp field(text),
    do: if(String.contains?(text, [",", "\"", "\r", "\n"]), do: quoted(text), else: text)

  defp quoted(text), do: "\"" <> String.replace(text, "\"", "\"\"") <> "\""

  @doc "A stream of sound between two times as a WAV file of 32-bit floats, all its channels; gaps are silence."
  @spec wav(Source.t(), String.t(), Situ.Time.t(), Situ.Time.t()) ::
          {:ok, iodata()} | {:error, Situ.Error.t()}
  def wav(source, stream, from, to) do
    stretches(from, to)
    |> Enum.reduce_while({:ok, []}, fn {a, b}, {:ok, parts} ->
      case Sound.frames(source, stream, a, b) do
        {:ok, part} -> {:cont, {:ok, [{part, b - a} | parts]}}
        error -> {:halt, error}
      end
    end)
    |> case do
      {:ok, parts} -> parts |> Enum.reverse() |> joined()
      error -> error
    end
  end

  # A stretch lasts as long in the file as in the recording, also where there is no sound, or not up to its end.
  defp joined(parts) do
    case Enum.find(parts, fn {{_, _, _, samples}, _} -> samples != "" end) do
      nil ->
        {:error, Situ.Error.new(:silent, "there is no sound between these times")}

      {{_, rate, channels, _}, _} ->
        frame = 4 * channels
        last = length(parts) - 1

        data =
          for {{{_, r, n, samples}, span}, i} <- Enum.with_index(parts) do
            samples = if {r, n} == {rate, channels}, do: samples, else: ""
            missing = frame * round(rate * span / @second) - byte_size(samples)
            if i == last, do: samples, else: [samples, :binary.copy(<<0>>, max(missing, 0))]
          end

        {:ok, [header(rate, channels, IO.iodata_length(data)), data]}
    end
  end

  defp stretches(from, to),
    do: for(a <- from..(to - 1)//@stretch, do: {a, min(a + @stretch, to)})

  # Microsoft, RIFF WAVE: format 3 is IEEE float.
  defp header(rate, channels, bytes) do
    frame = 4 * channels

    <<"RIFF", 50 + bytes::little-32, "WAVE", "fmt ", 18::little-32, 3::little-16,
      channels::little-16, rate::little-32, frame * rate::little-32, frame::little-16,
      32::little-16, 0::little-16, "fact", 4::little-32, div(bytes, frame)::little-32, "data",
      bytes::little-32>>
  end
end
