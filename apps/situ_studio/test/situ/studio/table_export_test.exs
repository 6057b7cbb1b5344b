defmodule Situ.Studio.TableExportTest do
  # Exports a selection as CSV, Parquet and WAV.
  use ExUnit.Case, async: true

  alias Situ.{AudioBuffer, AudioFormat, Message}
  alias Situ.Studio.{History, TableExport, Recordings}

  defp source(streams) do
    history = History.new(live: false, seconds: 3_600)

    for {name, rows} <- streams, {time, data} <- rows do
      History.put(history, name, %Message{data: data, originating_time: time}, 8)
    end

    Recordings.History.wrap(history)
  end

  defp csv(source, streams, from, to),
    do:
      source
      |> TableExport.csv_chunks(streams, from, to)
      |> Enum.join()
      |> String.split("\r\n", trim: true)

  test "exports all messages of long streams in order, including both ends" do
    rows = for i <- 0..4_999, do: {i * 10, i}
    source = source(%{"A" => rows, "B" => [{15, "x,\"y\"\nz"}]})
    [header | lines] = csv(source, ["A"], 10, 49_980)
    assert header == "time_ns,time,stream,value"
    assert length(lines) == 4_998
    assert hd(lines) == "10,1970-01-01T00:00:00.000000010Z,A,1"
    assert List.last(lines) == "49980,1970-01-01T00:00:00.000049980Z,A,4998"
    text = source |> TableExport.csv_chunks(["B"], 0, 100) |> Enum.join()
    assert text =~ ~s(,B,"x,""y""\nz"\r\n)
    assert csv(source, ["none"], 0, 100) == [header]
  end

  test "neutralizes text that a spreadsheet would run, and keeps numbers" do
    row = &TableExport.csv_row("S", %Message{data: &1, originating_time: 0})
    assert row.("=1+1") =~ ",'=1+1\r\n"
    assert row.(-1.5) =~ ",-1.5\r\n"
    assert row.(true) =~ ",true\r\n"
    assert row.(nil) =~ "S,\r\n"
    assert row.(%{a: [1]}) =~ ~s("{""a"":[1]}")
    assert row.(<<255, 0>>) =~ "2 bytes"

    assert row.(%{"jpeg" => <<255, 216>>, "at" => {1, 2}}) =~
             ~s("{""at"":[1,2],""jpeg"":""/9g=""}")

    assert row.(self()) =~ "PID"
  end

  test "exports the audio of the interval, with silence in gaps" do
    format = AudioFormat.pcm(1_000, 1)
    data = :binary.copy(<<16_384::little-16>>, 500)
    s = 1_000_000_000
    buffers = for t <- [s, 2 * s], do: {t, %AudioBuffer{format: format, data: data}}
    {:ok, wav} = TableExport.encode_wav(source(%{"Mic" => buffers}), "Mic", 0, 2 * s)
    wav = IO.iodata_to_binary(wav)
    assert <<"RIFF", size::little-32, "WAVE", _::binary>> = wav
    assert size + 8 == byte_size(wav)
    samples = for <<x::little-float-32 <- binary_part(wav, 58, byte_size(wav) - 58)>>, do: x
    assert length(samples) == 2_000
    assert Enum.map([100, 600, 1_200, 1_700], &Enum.at(samples, &1)) == [0.0, 0.5, 0.0, 0.5]

    assert {:error, %{code: :silent}} =
             TableExport.encode_wav(source(%{"Mic" => []}), "Mic", 0, s)
  end

  test "keeps the channels of audio, and its position after a long silence" do
    s = 1_000_000_000
    format = AudioFormat.pcm(1_000, 2)
    data = :binary.copy(<<16_384::little-16, -8_192::little-signed-16>>, 1_000)
    buffers = for t <- [s, 26 * s], do: {t, %AudioBuffer{format: format, data: data}}
    {:ok, wav} = TableExport.encode_wav(source(%{"Mic" => buffers}), "Mic", 0, 30 * s)
    wav = IO.iodata_to_binary(wav)

    assert <<_::binary-22, 2::little-16, 1_000::little-32, 8_000::little-32, 8::little-16,
             _::binary>> = wav

    frames =
      for <<l::little-float-32, r::little-float-32 <- binary_part(wav, 58, byte_size(wav) - 58)>>,
        do: {l, r}

    assert length(frames) == 26_000

    assert Enum.map([500, 1_500, 24_900, 25_500], &Enum.at(frames, &1)) ==
             [{0.5, -0.25}, {0.0, 0.0}, {0.0, 0.0}, {0.5, -0.25}]
  end

  @tag :tmp_dir
  test "a Parquet file has the rows of all streams, except images", %{tmp_dir: dir} do
    rows = for i <- 0..4_999, do: {i * 10, i / 2}
    image = Situ.Image.new_filled(2, 2, :gray8)
    source = source(%{"A" => rows, "B" => [{15, 7.0}], "Camera" => [{20, image}]})
    path = Path.join(dir, "part.parquet")

    assert {:ok, 4_999} =
             TableExport.write_parquet(source, ["A", "B", "Camera"], 10, 49_980, path)

    # The messages of B are earlier than A's last message, so the reader skips them.
    read = for {time, %{"value" => v}} <- Situ.Bridge.Parquet.messages(path), do: {time, v}
    assert read == Enum.slice(rows, 1, 4_998)

    assert {:error, %{code: :no_table}} =
             TableExport.write_parquet(source, ["Camera"], 0, 100, path)
  end
end
