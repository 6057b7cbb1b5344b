defmodule Situ.Studio.TableExport do
  @moduledoc false
  # Exports messages from a selection: tables as CSV (RFC 4180) or Parquet, and audio as a WAV
  # file.
  alias Situ.Bridge.Format.Value
  alias Situ.Studio.{AudioSamples, StreamReader}

  # Messages are read in pages, so that memory use does not depend on the length of the selection.
  @page 2_000
  @second 1_000_000_000
  @stretch 10 * @second

  @doc "Returns the CSV rows of streams between two times, including a header, as an enumerable of text chunks."
  @spec csv_chunks(Situ.Recording.t(), [String.t()], Situ.Time.t(), Situ.Time.t()) ::
          Enumerable.t()
  def csv_chunks(source, streams, from, to) do
    rows = Stream.flat_map(streams, &csv_pages(source, &1, from, to))
    Stream.concat(["time_ns,time,stream,value\r\n"], rows)
  end

  defp csv_pages(source, stream, from, to),
    do: source |> stream_messages(stream, from, to) |> Stream.map(&encode_rows(stream, &1))

  defp stream_messages(source, stream, from, to) do
    Stream.unfold(from, fn
      nil ->
        nil

      at ->
        case StreamReader.read_messages(source, stream, at, to, @page) do
          {:ok, messages, more} -> {messages, next_start(messages, more)}
          {:error, _} -> nil
        end
    end)
  end

  @doc """
  Writes the rows to a Parquet file at `path` and returns `{:ok, rows}`. The columns are the times, `stream`, and
  `value` or one column per member of maps and structs (`Situ.Bridge.Parquet`). Image and audio streams are left out;
  if there are no other streams, the error is `:no_table`.
  """
  @spec write_parquet(Situ.Recording.t(), [String.t()], Situ.Time.t(), Situ.Time.t(), Path.t()) ::
          {:ok, non_neg_integer()} | {:error, Situ.Error.t()}
  def write_parquet(source, streams, from, to, path) do
    case Enum.filter(streams, &tabular?(source, &1, to)) do
      [] ->
        {:error,
         Situ.Error.new(:no_table, "images and audio cannot be exported as a table",
           fix: "select numbers, states or text; export audio as WAV"
         )}

      some ->
        parts =
          Stream.flat_map(some, fn stream ->
            source |> stream_messages(stream, from, to) |> Stream.map(&label_messages(&1, stream))
          end)

        Situ.Bridge.Parquet.write_messages(parts, path, compression: :gzip)
    end
  end

  defp label_messages(messages, stream),
    do: for(m <- messages, do: %{m | data: %{"stream" => stream, "value" => m.data}})

  defp tabular?(source, stream, to) do
    case StreamReader.latest_at(source, stream, to) do
      {:ok, %{data: %module{}}} -> not Situ.Codec.implemented_by?(module)
      {:ok, _} -> true
      _ -> false
    end
  end

  defp next_start([_ | _] = messages, :more), do: List.last(messages).originating_time + 1
  defp next_start(_, _), do: nil

  defp encode_rows(stream, messages),
    do: messages |> Enum.map(&csv_row(stream, &1)) |> IO.iodata_to_binary()

  @doc """
  Encodes one CSV row: ns time, date, stream, value. Structured values become JSON (with bytes as base64), binaries
  their size.

      iex> message = %Situ.Message{data: "say \\"hi\\"", originating_time: 1_500_000_000, creation_time: 1_500_000_000}
      iex> Situ.Studio.TableExport.csv_row("Speech", message)
      ~s(1500000000,1970-01-01T00:00:01.500000000Z,Speech,"say ""hi\"""\\r\\n)
  """
  @spec csv_row(String.t(), Situ.Message.t()) :: String.t()
  def csv_row(stream, %Situ.Message{originating_time: time, data: data}) do
    fields = [Integer.to_string(time), Situ.Time.to_iso8601(time), stream, format_value(data)]
    fields |> Enum.map(&escape_formula/1) |> Situ.CsvRow.encode_row() |> IO.iodata_to_binary()
  end

  defp format_value(data) when is_number(data), do: to_string(data)
  defp format_value(data) when is_boolean(data), do: to_string(data)
  defp format_value(nil), do: ""
  defp format_value(data) when is_atom(data), do: Atom.to_string(data)

  defp format_value(data) when is_binary(data),
    do: if(String.valid?(data), do: data, else: format_size(data))

  # Images, audio and similar values have no JSON form.
  defp format_value(data) when is_struct(data), do: inspect(data, limit: 20, printable_limit: 200)

  defp format_value(data) do
    data |> Value.to_plain() |> Situ.JSON.encode()
  catch
    {:not_writable, _} -> inspect(data, limit: 20, printable_limit: 200)
  end

  defp format_size(data), do: "#{byte_size(data)} bytes"

  # An apostrophe keeps spreadsheets from running text as a formula; numbers are unchanged.
  defp escape_formula(<<c, _::binary>> = text) when c in ~c"=+-@" do
    if match?({_, ""}, Float.parse(text)), do: text, else: "'" <> text
  end

  defp escape_formula(text), do: text

  @doc "Encodes audio between two times as a WAV file of 32-bit floats with all channels; gaps are silence."
  @spec encode_wav(Situ.Recording.t(), String.t(), Situ.Time.t(), Situ.Time.t()) ::
          {:ok, iodata()} | {:error, Situ.Error.t()}
  def encode_wav(source, stream, from, to) do
    split_range(from, to)
    |> Enum.reduce_while({:ok, []}, fn {a, b}, {:ok, parts} ->
      case AudioSamples.interleaved_samples(source, stream, a, b) do
        {:ok, part} -> {:cont, {:ok, [{part, b - a} | parts]}}
        error -> {:halt, error}
      end
    end)
    |> case do
      {:ok, parts} -> parts |> Enum.reverse() |> join_parts()
      error -> error
    end
  end

  # Pads every part except the last to its duration in the recording, even if it contains little or no audio.
  defp join_parts(parts) do
    case Enum.find(parts, fn {{_, _, _, samples}, _} -> samples != "" end) do
      nil ->
        {:error, Situ.Error.new(:silent, "there is no audio between these times")}

      {{_, rate, channels, _}, _} ->
        frame = 4 * channels
        last = length(parts) - 1

        data =
          for {{{_, r, n, samples}, span}, i} <- Enum.with_index(parts) do
            samples = if {r, n} == {rate, channels}, do: samples, else: ""
            missing = frame * round(rate * span / @second) - byte_size(samples)
            if i == last, do: samples, else: [samples, :binary.copy(<<0>>, max(missing, 0))]
          end

        {:ok, [wav_header(rate, channels, IO.iodata_length(data)), data]}
    end
  end

  defp split_range(from, to),
    do: for(a <- from..(to - 1)//@stretch, do: {a, min(a + @stretch, to)})

  # Format code 3 of Microsoft's RIFF WAVE specification is IEEE float.
  defp wav_header(rate, channels, bytes) do
    frame = 4 * channels

    <<"RIFF", 50 + bytes::little-32, "WAVE", "fmt ", 18::little-32, 3::little-16,
      channels::little-16, rate::little-32, frame * rate::little-32, frame::little-16,
      32::little-16, 0::little-16, "fact", 4::little-32, div(bytes, frame)::little-32, "data",
      bytes::little-32>>
  end
end
