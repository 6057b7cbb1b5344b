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

    # In the umbrella's own test run the media app is loaded, and sound comes as its struct; the shape is one.
    assert %{rate: 8_000, channels: 1, sample: :s16} = hd(messages).data.format

    {:ok, [plain], _} =
      Store.Wav.read(%{store.state | codec: nil}, hd(Store.streams(store)), 0, :unbounded, 1, [])

    assert %{format: %{rate: 8_000, channels: 1, sample: :s16}, data: bytes} = plain.data
    assert bytes == hd(messages).data.data
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

  test "CSV of any length: line breaks in quotes, part after part, the same by time, by index and from the front",
       %{tmp_dir: root} do
    path = Path.join(root, "long.csv")
    n = 3_500

    rows =
      for i <- 0..(n - 1) do
        note = if rem(i, 7) == 0, do: ~s("line #{i},\r\nand ""more"""), else: "n#{i}"
        gap = if rem(i, 5) == 0, do: "", else: "#{i}"
        late = if rem(i, 1_000) == 999, do: "0,1,late,\r\n", else: ""
        "#{i},#{i}.5,#{note},#{gap}\r\n" <> late
      end

    File.write!(path, ["\uFEFFt_ms,x,note,007\r\n" | rows])
    store = Store.open!(path)

    assert [
             %{name: "x", type: :float, count: ^n},
             %{name: "note", type: :string, count: ^n},
             %{name: "007", type: :integer, count: 2_800}
           ] = Store.streams(store)

    assert [{_, line, "line " <> _}, _, _] = Store.info(store).damage
    # 1,000 rows and 143 further breaks within quotes before the late one, behind the heading.
    assert line == 1 + 1_000 + 143 + 1
    assert [{0, "line 0,\r\nand \"more\""}, {1_000_000, "n1"}] = values(store, "note", 2)

    for {name, wanted} <- [
          {"x", for(i <- 0..(n - 1), do: {i, i + 0.5})},
          {"007", for(i <- 0..(n - 1), rem(i, 5) != 0, do: {i, i})}
        ] do
      assert values(store, name, n) == for({i, v} <- wanted, do: {i * 1_000_000, v})

      for {{i, v}, ordinal} <- Enum.with_index(wanted),
          rem(ordinal, 97) == 0 or i in 994..1_006 do
        assert {:ok, %{data: ^v, sequence_id: id}} = Store.at(store, name, ordinal)
        assert id == ordinal + 1
        assert {:ok, %{data: ^v}} = Store.first_at(store, name, i * 1_000_000)
        assert {:ok, %{data: ^v}} = Store.latest_at(store, name, i * 1_000_000 + 1)
      end
    end
  end

  defp values(store, name, n) do
    for m <- Enum.take(Store.messages(store, name), n), do: {m.originating_time, m.data}
  end

  test "CSV that is none says where and why", %{tmp_dir: root} do
    why = fn text, opts ->
      path = Path.join(root, "bad#{:erlang.phash2({text, opts})}.csv")
      File.write!(path, text)
      assert {:error, %{code: :not_csv, why: why}} = Store.open(path, reader_opts: opts)
      why
    end

    assert why.("t,x\n1,2\n2,\xFF\n", []) =~ "line 3: it is not UTF-8"
    assert why.("only\n1\n", []) =~ "one column"
    assert why.("t,x\n1,2\n", separator: ", ") =~ "separator"

    assert why.(["t,x\n1,2\n2,\"", String.duplicate("x", 40_000_000)], []) =~
             "line 3: a row of more"

    # Texts of a column of texts stay as written.
    path = Path.join(root, "codes.csv")
    File.write!(path, "t,code\n0,007\n1,x\n")
    assert [{0, "007"}, {1_000_000_000, "x"}] = path |> Store.open!() |> values("code", 9)
    # A file that was cut since is an error, no crash.
    store = Store.open!(path)
    File.write!(path, "t,code\n")
    assert {:error, %{code: :damaged}} = Store.read(store, "code")
  end
end
