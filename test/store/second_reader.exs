# Stores written by Situ and read by test/store/read_store.py, which is based on
# priv/schema/store.md alone, must contain the same messages, statistics and pyramids. `write
# FOLDER` writes the stores, and `compare FOLDER` compares them.
defmodule SecondReader do
  alias Situ.{AudioBuffer, AudioFormat, Image, Message, Store}
  alias Situ.Store.Writer

  @reader Path.join(__DIR__, "read_store.py")

  def write(root) do
    # The extents are small, so that streams continue from one to the next.
    options = [first_extent: 65_536, max_extent: 131_072]
    {:ok, writer} = Writer.create("closed", root, options)
    for {name, messages, options} <- streams(), do: fill(writer, name, messages, options)
    :ok = Writer.close(writer)
    mended(root)
    # A killed writer leaves a store that is committed but not closed.
    {:ok, writer} = Writer.create("killed", root, options)
    {:ok, stream} = Writer.stream(writer, "Ints", type: :integer)
    {:ok, _} = Writer.append(stream, numbers(1..3_000))
    System.halt(0)
  end

  # A chunk in the middle is lost. After a repair, the rest is intact.
  defp mended(root) do
    {:ok, writer} = Writer.create("mended", root)
    for name <- ["Ints", "Words"], do: fill(writer, name, messages(Enum.to_list(1..5_000)), [])
    :ok = Writer.close(writer)
    file = Path.join(writer.path, "data-000000.situ")
    bytes = File.read!(file)
    [{_, _}, {_, _}, {_, _}, {at, _}, {_, _} | _] = :binary.matches(bytes, "CHK2")

    File.write!(file, [
      binary_part(bytes, 0, at),
      "DENT",
      binary_part(bytes, at + 4, byte_size(bytes) - at - 4)
    ])

    {:ok, %{dropped: 1}} = Store.repair(writer.path)
    true = Store.count(Store.open!(writer.path), "Ints") < 5_000
  end

  defp fill(writer, name, messages, options) do
    {:ok, stream} = Writer.stream(writer, name, options)

    stream =
      messages
      |> Enum.chunk_every(700)
      |> Enum.reduce(stream, fn batch, stream ->
        batch |> then(&Writer.append(stream, &1)) |> elem(1)
      end)

    if messages != [],
      do: {:ok, _} = Writer.close_stream(stream, List.last(messages).originating_time)
  end

  defp streams do
    words = for i <- 1..2_000, do: "word #{rem(i * 7, 100)} of #{i}"

    terms =
      for i <- 1..1_500, do: {:pose, %{"x" => i * 0.5, y: [i, nil, -i], big: 3 ** rem(i, 80)}}

    mixed = [1, 2.5, "text", true, nil, :atom, {1}, 2 ** 70, -5, <<1::3>>, "", 0.0, -0.0, false]

    sound =
      for i <- 1..50,
          do:
            AudioBuffer.from_samples(
              for(n <- 1..160, do: rem(n * i, 3_000)),
              AudioFormat.pcm(16_000)
            )

    pictures =
      for i <- 1..5,
          do:
            Image.new!(width: 100, height: 150, format: :rgb24, data: :binary.copy(<<i>>, 45_000))

    [
      {"Empty", [], []},
      {"Ints", numbers(1..5_000), [type: :integer]},
      {"Floats", for(i <- 1..5_000, do: message(i, :math.sin(i / 50))), [type: :float]},
      {"Flags", for(i <- 1..1_100, do: message(i, Enum.at([true, false, nil], rem(i, 3)))), []},
      {"Words", messages(words), [type: :string]},
      {"Words packed", messages(words), [compression: :lz4]},
      {"Words packed more", messages(words), [compression: :zstd]},
      {"Terms", messages(terms), [metadata: %{"unit" => "m"}]},
      {"Terms packed", messages(terms), [compression: :lz4]},
      {"Mixed", messages(mixed), []},
      {"Each by itself", messages(mixed), [large: true]},
      {"Long", messages(for(n <- [32_767, 32_768, 200_000], do: :crypto.strong_rand_bytes(n))),
       []},
      {"Long packed", messages([String.duplicate("long ", 20_000)]), [compression: :lz4]},
      {"Sound", messages(sound), [type: AudioBuffer]},
      {"Pictures", messages(pictures), [type: Image]}
    ]
  end

  # Times before and after 1970, uneven steps, skipped ids, and latencies of both signs.
  defp numbers(range), do: for(i <- range, do: message(i, (i - 2_000) * i * i * i * i))
  defp messages(values), do: for({value, i} <- Enum.with_index(values), do: message(i, value))

  defp message(i, data) do
    time = (i - 1_000) * 1_000_003 + rem(i * 17, 1_000)
    creation = time + rem(i * 7_919, 3_000_000) - 1_000_000

    %Message{
      data: data,
      originating_time: time,
      creation_time: creation,
      sequence_id: i * 2 + div(i, 100) * 1_000_000
    }
  end

  def compare(root) do
    for name <- ["closed", "killed", "mended"],
        do: compare_store(Store.open!(Path.join(root, name)))

    bins(Store.open!(Path.join(root, "closed")))
  end

  defp compare_store(store) do
    [head | rest] = read([store.path])

    ^head = %{
      "store" => Store.info(store).name,
      "closed" => Store.closed?(store),
      "created" => Store.info(store).created
    }

    streams = Store.streams(store)
    true = streams != []
    [] = Enum.reduce(streams, rest, &stream(store, &1, &2))
    IO.puts("#{Store.info(store).name}: #{length(streams)} streams are the same to both")
  end

  defp stream(store, info, [head | lines]) do
    ^head =
      %{"stream" => info.name, "type" => info.type_name, "closed" => info.closed}
      |> Map.merge(
        if info.count > 0,
          do: %{"count" => info.count, "size" => info.size, "latency" => info.latency_sum / 1},
          else: %{}
      )
      |> Map.merge(
        case info.supplemental,
          do:
            (
              {_, bytes} -> %{"metadata" => Base.encode64(bytes)}
              nil -> %{}
            )
      )

    {own, lines} = Enum.split_while(lines, &is_map_key(&1, "sequence"))

    case lines do
      [%{"skipped" => tool} | lines] ->
        IO.puts("#{info.name}: not compared, no #{tool} here")
        lines

      _ ->
        same!(info.name, own, Enum.to_list(Store.messages(store, info)))
        lines
    end
  end

  defp same!(_name, [], []), do: :ok

  defp same!(name, [line | lines], [message | messages]) do
    envelope = {line["sequence"], line["time"], line["creation"]}

    if envelope != {message.sequence_id, message.originating_time, message.creation_time} or
         not same?(line, message.data),
       do: raise("#{name}: #{inspect(line, limit: 9)} is not #{inspect(message, limit: 9)}")

    same!(name, lines, messages)
  end

  defp same!(name, lines, messages),
    do: raise("#{name}: #{length(lines)} more there, #{length(messages)} more here")

  defp same?(%{"codec" => codec, "bytes" => bytes}, %module{} = data),
    do:
      codec == module.codec_name() and
        Base.decode64!(bytes) == IO.iodata_to_binary(module.encode(data))

  defp same?(%{"encoding" => 3, "bytes" => bytes}, data), do: Base.decode64!(bytes) === data

  defp same?(%{"encoding" => 4, "bytes" => bytes}, data),
    do: :erlang.binary_to_term(Base.decode64!(bytes)) === data

  # JSON preserves all bits of a float except the sign of zero.
  defp same?(%{"data" => data}, own), do: data === own or (data == own and is_float(own))

  # Each bin of tracks must have the messages of its time, and their states in total.
  defp tallies(store, read) do
    groups = Enum.group_by(read, &{&1["stream"], &1["level"] - 64})
    true = map_size(groups) > 15

    for {{name, level}, bins} <- groups do
      messages = Enum.to_list(Store.messages(store, name))

      starts =
        Enum.map(messages, &(Bitwise.bsr(&1.originating_time, level) |> Bitwise.bsl(level)))

      counted = for bin <- bins, do: {bin["start"], bin["count"]}

      if Enum.sort(Enum.frequencies(starts)) != counted,
        do: raise("#{name}: counts at level #{level}")

      for %{"tracks" => tracks} <- bins,
          %{"states" => states, "key" => nil} <- tracks,
          [state, n] <- states do
        term = state && state |> Base.decode64!() |> :erlang.binary_to_term()
        had = Enum.count(messages, &(&1.data === term))
        if state && had < n, do: raise("#{name}: #{had} messages are #{inspect(term)}, not #{n}")
      end
    end

    IO.puts("tracks: #{length(read)} bins are the same to both")
  end

  # Each stored bin is recomputed from the messages.
  defp bins(store) do
    {tallies, read} = ["--bins", store.path] |> read() |> Enum.split_with(&is_map/1)
    tallies(store, tallies)
    names = read |> Enum.map(&hd/1) |> Enum.uniq()
    true = "Floats" in names and "Ints" in names and "Sound" in names and length(read) > 100

    for {[name, level], stored} <- Enum.group_by(read, &Enum.take(&1, 2), &Enum.drop(&1, 2)),
        name != "Sound" do
      points =
        for m <- Store.messages(store, name), n = drawn(m.data), do: {m.originating_time, n}

      made =
        for group <- Enum.chunk_by(points, &Bitwise.bsr(elem(&1, 0), level)) do
          values = Enum.map(group, &elem(&1, 1))
          start = group |> hd() |> elem(0) |> Bitwise.bsr(level) |> Bitwise.bsl(level)
          [start, Enum.min(values), Enum.max(values), List.last(values), length(values)]
        end

      if made != stored, do: raise("#{name}: other bins at level #{level}")
    end

    IO.puts("pyramids of #{Enum.join(names, ", ")}: #{length(read)} bins are the same to both")
  end

  # Numbers of up to 8 bytes and booleans are drawn, independent of other values in the stream.
  defp drawn(n) when is_float(n), do: n
  defp drawn(n) when is_integer(n) and abs(n) < 0x10000000000000000, do: n / 1
  defp drawn(flag) when is_boolean(flag), do: if(flag, do: 1.0, else: 0.0)
  defp drawn(_), do: nil

  defp read(arguments) do
    {text, 0} = System.cmd("python3", [@reader | arguments])

    for line <- String.split(text, "\n", trim: true),
        {:ok, value} = Situ.JSON.decode(line),
        do: value
  end
end

case System.argv() do
  ["write", root] -> SecondReader.write(root)
  ["compare", root] -> SecondReader.compare(root)
end
