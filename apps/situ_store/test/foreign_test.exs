defmodule Situ.Store.ForeignTest do
  use ExUnit.Case, async: true
  alias Situ.{Pipeline, Store}

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

  test "a WAV file opens, lists, seeks and reads like a store", %{tmp_dir: root} do
    {path, samples} = wav(root, 1.01)
    store = Store.open!(path)
    assert %{name: "sound", closed?: true, live?: false} = Store.info(store)

    assert [%{name: "Audio", count: 51, first: 20_000_000, last: 1_010_000_000}] =
             Store.streams(store)

    {:ok, messages} = Store.read(store, "Audio")
    assert messages |> Enum.map(& &1.data.data) |> IO.iodata_to_binary() == samples
    # In the umbrella's own test run the media app is loaded, and sound comes as its struct.
    sound = hd(messages).data
    assert %{rate: 8_000, channels: 1, sample: :s16} = Map.get(sound, :format, sound)
    assert {:ok, %{originating_time: 500_000_000}} = Store.latest_at(store, "Audio", 519_999_999)
    assert {:ok, %{originating_time: 520_000_000}} = Store.first_at(store, "Audio", 500_000_001)
    assert {:ok, nil} = Store.first_at(store, "Audio", 2_000_000_000)
    {:ok, later} = Store.open(path, reader_opts: [start: 1_000])
    assert {:ok, %{originating_time: 20_001_000}} = Store.at(later, "Audio", 0)
  end

  test "every seek of a WAV whose rate does not divide a second is exact", %{tmp_dir: root} do
    {path, _} = wav(root, 1.0, rate: 11_025)
    store = Store.open!(path)
    all = Enum.to_list(Store.messages(store, "Audio"))

    for {m, i} <- Enum.with_index(all) do
      assert {:ok, %{sequence_id: id}} = Store.first_at(store, "Audio", m.originating_time)
      assert id == i + 1
      assert {:ok, %{sequence_id: ^id}} = Store.latest_at(store, "Audio", m.originating_time)
    end
  end

  test "a WAV cut short is read as far as it goes; a broken one is an error", %{tmp_dir: root} do
    {path, samples} = wav(root, 1.0)
    bytes = File.read!(path)
    File.write!(path, binary_part(bytes, 0, 5_000))
    {:ok, messages} = path |> Store.open!() |> Store.read("Audio")
    got = messages |> Enum.map(& &1.data.data) |> IO.iodata_to_binary()
    assert got == binary_part(samples, 0, byte_size(got)) and byte_size(got) > 4_900

    for cut <- 0..55 do
      File.write!(path, binary_part(bytes, 0, cut))
      assert {:error, %{code: code, why: _}} = Store.open(path)
      assert code == :not_wav
    end
  end

  test "CSV columns are streams; a pipeline replays them, a store is made of them", %{
    tmp_dir: root
  } do
    path = Path.join(root, "imu.csv")

    File.write!(path, """
    time_ms;acc;gyro;label
    0;1;0.5;"rest; still"
    10;2;1;walk
    20;3.5;;walk
    15;9;9;late
    30;x
    40;4;2.25;"say ""hi""\"
    """)

    store = Store.open!(path)

    assert [
             %{name: "acc", type: :float, count: 4},
             %{name: "gyro", count: 3},
             %{name: "label", type: :string}
           ] = Store.streams(store)

    assert Enum.map(Store.messages(store, "acc"), &{&1.originating_time, &1.data}) ==
             [{0, 1.0}, {10_000_000, 2.0}, {20_000_000, 3.5}, {40_000_000, 4.0}]

    assert Enum.map(Store.messages(store, "label"), & &1.data) == [
             "rest; still",
             "walk",
             "walk",
             "say \"hi\""
           ]

    assert [{_, 5, late}, {_, 6, short}] = Store.info(store).damage
    assert late =~ "forward" and short =~ "2 fields"
    {:ok, width, bins} = Store.summary(store, "acc", 0, 40_000_000, 2)
    assert width == 16_777_216
    assert Enum.map(bins, &elem(&1, 4)) == [2, 1, 1]

    {:ok, copy} = Store.copy(path, Path.join(root, "imu"))
    test = self()

    {:ok, _} =
      Pipeline.run(fn p ->
        for source <- [path, copy],
            do:
              p
              |> Store.importer(source)
              |> Store.stream("gyro")
              |> Situ.each(&send(test, {source, &1}))
      end)

    for source <- [path, copy], v <- [0.5, 1.0, 2.25], do: assert_received({^source, ^v})
  end

  test "CSV times: ISO 8601, units, no heading, a named column", %{tmp_dir: root} do
    times = fn text, opts ->
      path = Path.join(root, "t#{:erlang.phash2({text, opts})}.csv")
      File.write!(path, text)

      with {:ok, store} <- Store.open(path, reader_opts: opts),
           do:
             store |> Store.messages(hd(Store.streams(store))) |> Enum.map(& &1.originating_time)
    end

    assert times.("t,v\n1970-01-01T00:00:01.5Z,1\n1970-01-01T00:00:02Z,2\n", []) == [
             1_500_000_000,
             2_000_000_000
           ]

    assert times.("Timestamp (us),v\n5,1\n7,2\n", []) == [5_000, 7_000]
    assert times.("0.5,1\n1.5,2\n", []) == [500_000_000, 1_500_000_000]
    assert times.("v,when\n1,5\n2,6\n", time: "when", unit: :ms) == [5_000_000, 6_000_000]
    assert {:error, %{code: :not_csv, why: why}} = times.("v,when\n1,5\n", time: "whne")
    assert why =~ "when"
    assert {:error, %{code: :not_csv}} = times.("", [])
  end
end
