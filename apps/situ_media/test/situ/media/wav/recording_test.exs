defmodule Situ.Media.Wav.RecordingTest do
  use ExUnit.Case, async: true
  alias Situ.Store

  @moduletag :tmp_dir

  defp wav(root, seconds, opts \\ []) do
    rate = opts[:rate] || 8_000

    samples =
      for i <- 0..(round(seconds * rate) - 1),
          into: <<>>,
          do: <<rem(i, 1_000) - 500::little-signed-16>>

    data = <<"data", byte_size(samples)::little-32, samples::binary>>

    format =
      <<"fmt ", 16::little-32, 1::little-16, 1::little-16, rate::little-32, rate * 2::little-32,
        2::little-16, 16::little-16>>

    extra = <<"LIST", 3::little-32, "abc", 0>>
    path = Path.join(root, "sound.wav")
    File.write!(path, ["RIFF", <<byte_size(data) + 40::little-32>>, "WAVE", format, extra, data])
    {path, samples}
  end

  test "opens, lists, seeks and reads a WAV file like a store", %{tmp_dir: root} do
    {path, samples} = wav(root, 1.01)
    store = Store.open!(path)
    assert %{name: "sound", closed?: true, live?: false} = Store.info(store)

    assert [%{name: "Audio", count: 51, first: 20_000_000, last: 1_010_000_000}] =
             Store.streams(store)

    {:ok, messages} = Store.read(store, "Audio")
    assert messages |> Enum.map(& &1.data.data) |> IO.iodata_to_binary() == samples

    assert Enum.all?(messages, &match?(%Situ.AudioBuffer{}, &1.data))
    assert hd(messages).data.format == Situ.AudioFormat.pcm(8_000)
    assert {:ok, %{originating_time: 500_000_000}} = Store.latest_at(store, "Audio", 519_999_999)
    assert {:ok, %{originating_time: 520_000_000}} = Store.first_at(store, "Audio", 500_000_001)
    assert {:ok, nil} = Store.first_at(store, "Audio", 2_000_000_000)
    {:ok, later} = Store.open(path, reader_opts: [start: 1_000])
    assert {:ok, %{originating_time: 20_001_000}} = Store.at(later, "Audio", 0)
  end

  test "every seek is exact when the rate does not divide a second", %{tmp_dir: root} do
    {path, _} = wav(root, 1.0, rate: 11_025)
    store = Store.open!(path)
    all = Enum.to_list(Store.messages(store, "Audio"))

    for {m, i} <- Enum.with_index(all) do
      assert {:ok, %{sequence_id: id}} = Store.first_at(store, "Audio", m.originating_time)
      assert id == i + 1
      assert {:ok, %{sequence_id: ^id}} = Store.latest_at(store, "Audio", m.originating_time)
    end
  end

  test "reads a truncated WAV file up to its end and rejects a broken one", %{tmp_dir: root} do
    {path, samples} = wav(root, 1.0)
    bytes = File.read!(path)
    File.write!(path, binary_part(bytes, 0, 5_000))
    {:ok, messages} = path |> Store.open!() |> Store.read("Audio")
    got = messages |> Enum.map(& &1.data.data) |> IO.iodata_to_binary()
    assert [{frames, why}] = path |> Store.open!() |> Store.info() |> Map.fetch!(:damage)
    assert frames == div(byte_size(got), 2) and why =~ "more than the file contains"
    assert got == binary_part(samples, 0, byte_size(got)) and byte_size(got) > 4_900

    for cut <- 0..55 do
      File.write!(path, binary_part(bytes, 0, cut))
      assert {:error, %{code: code, why: _}} = Store.open(path)
      assert code in [:unreadable_media, :bad_wav]
    end
  end

  test "a file that changes under an open recording is an error, not different audio", %{
    tmp_dir: root
  } do
    {path, _} = wav(root, 1.0)
    store = Store.open!(path)
    File.write!(path, binary_part(File.read!(path), 0, 2_000))
    assert {:error, %{code: :changed}} = Store.read(store, "Audio")
    File.rm!(path)
    assert {:error, %{code: :changed}} = Store.read(store, "Audio")
  end

  test "rejects a flood of chunks and impossible rates immediately", %{tmp_dir: root} do
    path = Path.join(root, "flood.wav")
    File.write!(path, ["RIFF", <<0::32>>, "WAVE", :binary.copy(<<"JUNK", 0::32>>, 2_000_000)])
    {us, {:error, error}} = :timer.tc(fn -> Store.open(path) end)
    assert error.code == :unreadable_media and error.why =~ "chunks"
    assert us < 1_000_000

    format = <<1::little-16, 1::little-16, 0xFFFFFFFF::32, 0::32, 2::little-16, 16::little-16>>
    head = ["RIFF", <<0::32>>, "WAVE", "fmt ", <<16::little-32>>, format]
    File.write!(path, [head, "data", <<2::little-32>>, 0, 0])
    assert {:error, %{code: :bad_wav}} = Store.open(path)
  end

  test "a pipeline can replay it and any process can read it", %{tmp_dir: root} do
    {path, samples} = wav(root, 0.5)
    store = Store.open!(path)
    {:ok, messages} = Task.await(Task.async(fn -> Store.read(store, "Audio") end))
    assert messages |> Enum.map(& &1.data.data) |> IO.iodata_to_binary() == samples
  end
end
