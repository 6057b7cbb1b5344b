defmodule Situ.Store.HostileTest do
  # Damaged stores, and stores with false contents but valid checksums, must return an error or less data, use little
  # memory and block no scheduler. `SITU_MUTATIONS` and `SITU_LIES` set the number of each (150). `SITU_LONG_SCHEDULE`
  # sets how many ms a scheduler may be blocked (500, because a busy machine blocks schedulers itself; for 5, run
  # `chrt -r 10 mix test ...`). `SITU_SEED` sets the first seed (0), so that a long run can be divided.
  use ExUnit.Case, async: false
  alias Situ.Store
  alias Situ.Store.Writer
  import Situ.Store.Test.Record, only: [message: 2]

  @moduletag :tmp_dir
  @moduletag timeout: Situ.Test.Budget.time_limit_ms()

  defp setting(name, default), do: String.to_integer(System.get_env(name) || "#{default}")

  defp base(root) do
    {:ok, writer} = Writer.create("base", root, first_extent: 65_536)

    add = fn name, options, n ->
      {:ok, stream} = Writer.stream(writer, name, options)
      {:ok, _} = Writer.append(stream, for(i <- 1..n, do: message(data(name, i), i * 1_000)))
    end

    add.("ints", [type: :integer, metadata: %{"unit" => "m"}], 1_500)
    add.("flags", [type: :boolean], 1_500)
    add.("terms", [], 600)
    add.("packed", [compression: :zstd], 300)
    add.("quick", [compression: :lz4], 300)
    add.("large", [large: true], 10)
    :ok = Writer.close(writer)
    writer.path
  end

  @names ~w(ints flags terms packed quick large)

  # Returns the data of message `i` of a stream.
  defp data("ints", i), do: i
  defp data("flags", i), do: rem(i, 7) < 3
  defp data("terms", i), do: %{"k" => i, l: [1, 2, {i}], t: {:ok, 1.5}}
  defp data("large", i), do: :binary.copy(<<i>>, 5_000)
  defp data(_texts, i), do: String.duplicate("abc#{i}", 50)

  # Overwrites some bytes and corrects every checksum, so that the reader has to validate the contents.
  defp lie(path, target) do
    File.rm_rf!(target)
    File.cp_r!(path, target)
    index = Path.join(target, "index.situ")
    <<_::binary-size(64), n::little-64, _::binary>> = bytes = File.read!(index)
    at = 4_096 + 64 * (:rand.uniform(n) - 1)
    entry = binary_part(bytes, at, 64)

    <<_::binary-9, lane, _::16, extent::little-32, offset::little-64, length::little-32,
      _::binary>> = entry

    if :rand.uniform(3) == 1 do
      entry = scratch(entry, 4, 64)
      File.write!(index, put(bytes, at, sign_entry(entry)))
    else
      kind = if lane == 1, do: "large", else: "data"
      file = Path.join(target, "#{kind}-#{String.pad_leading("#{extent}", 6, "0")}.situ")
      data = File.read!(file)

      chunk =
        data
        |> binary_part(offset, length)
        |> scratch(Enum.random([8, 112]), length)
        |> sign_chunk()

      File.write!(file, put(data, offset, chunk))
    end
  end

  # Damages files as disks, programs and people do: flips bits, overwrites ranges, truncates files and swaps parts.
  defp mutate(files, target) do
    mutated = Enum.reduce(1..:rand.uniform(4), files, fn _, files -> wound(files) end)
    for {name, bytes} <- mutated, do: File.write!(Path.join(target, name), bytes)
  end

  defp wound(files) do
    {name, bytes} = Enum.random(files)
    size = byte_size(bytes)
    at = :rand.uniform(max(size, 1)) - 1

    wounded =
      case :rand.uniform(6) do
        _ when size == 0 ->
          <<0::800>>

        n when n <= 2 ->
          <<byte>> = binary_part(bytes, at, 1)
          put(bytes, at, <<Bitwise.bxor(byte, Bitwise.bsl(1, :rand.uniform(8) - 1))>>)

        3 ->
          put(
            bytes,
            at,
            for(_ <- 1..min(200, size - at), into: <<>>, do: <<:rand.uniform(256) - 1>>)
          )

        4 ->
          binary_part(bytes, 0, at)

        5 ->
          {_, other} = Enum.random(files)
          stretch = binary_part(other, 0, min(byte_size(other), :rand.uniform(4_096)))
          put(bytes, at, binary_part(stretch, 0, min(byte_size(stretch), size - at)))

        6 ->
          # These bytes are the number of entries and the state of the index, which no checksum covers.
          if size > 96,
            do: put(bytes, 63 + :rand.uniform(32), <<:rand.uniform(256) - 1>>),
            else: bytes
      end

    Map.put(Map.new(files), name, wounded)
  end

  defp scratch(bytes, from, to) do
    Enum.reduce(1..:rand.uniform(3), bytes, fn _, bytes ->
      at = from + :rand.uniform(max(min(to, byte_size(bytes)) - from, 1)) - 1

      value =
        Enum.random([
          <<0>>,
          <<255>>,
          <<0xFF, 0xFF, 0xFF, 0x7F>>,
          <<128>>,
          <<:rand.uniform(256) - 1>>
        ])

      put(bytes, min(at, byte_size(bytes) - byte_size(value)), value)
    end)
  end

  defp put(bytes, at, value) do
    rest = at + byte_size(value)
    binary_part(bytes, 0, at) <> value <> binary_part(bytes, rest, byte_size(bytes) - rest)
  end

  defp sign_entry(<<_::32, rest::binary>>), do: <<crc(rest)::little-32, rest::binary>>

  defp sign_chunk(chunk) do
    <<_::binary-18, packed, _::binary>> = chunk
    <<table::little-32>> = binary_part(chunk, 84, 4)
    covered = if packed == 0, do: min(112 + table, byte_size(chunk)), else: 112

    chunk =
      put(chunk, 92, <<crc(binary_part(chunk, covered, byte_size(chunk) - covered))::little-32>>)

    put(chunk, 4, <<crc(binary_part(chunk, 8, covered - 8))::little-32>>)
  end

  # A lookup table for CRC-32C.
  @table List.to_tuple(
           for byte <- 0..255 do
             Enum.reduce(1..8, byte, fn _, c ->
               if Bitwise.band(c, 1) == 1,
                 do: Bitwise.bxor(Bitwise.bsr(c, 1), 0x82F63B78),
                 else: Bitwise.bsr(c, 1)
             end)
           end
         )

  defp crc(bytes) do
    import Bitwise

    for(<<byte <- bytes>>, reduce: 0xFFFFFFFF) do
      crc -> bxor(elem(@table, band(bxor(crc, byte), 0xFF)), bsr(crc, 8))
    end
    |> bxor(0xFFFFFFFF)
  end

  # With `check`, every message must be one that was written.
  defp ask(path, check) do
    with {:ok, store} <- Store.open(path) do
      Store.info(store)

      for info <- Store.streams(store) do
        for m <- Store.messages(store, info, skip_damage: true),
            check and info.name in @names,
            do: assert(m.data == data(info.name, div(m.originating_time, 1_000)))

        for part <- Store.columns(store, info, skip_damage: true),
            {time, value} <- pairs(part),
            check and info.name in @names,
            do: assert(value == data(info.name, div(time, 1_000)))

        _ = Store.at(store, info, 0)
        _ = Store.at(store, info, -1)
        _ = Store.latest_at(store, info, 500_000)
        _ = Store.summary(store, info, 0, 1_500_000, 100)
        _ = Store.Summary.read(store, info, 0, 1_500_000, 100)
        _ = Store.metadata(store, info)
        _ = Store.gaps(store, info, 1)
      end

      _ = Store.verify(path)
      _ = Store.repair(path, dry_run: true)
    end

    :asked
  rescue
    # Reading a stream of messages raises on damage.
    error in Situ.Error -> error.code
  end

  defp pairs(%Situ.Columns{} = columns), do: Situ.Columns.to_pairs(columns)
  defp pairs(messages), do: for(m <- messages, do: {m.originating_time, m.data})

  # Reads the store that `make` writes, `rounds` times, and checks memory and atoms. Returns the results and the
  # blocked schedulers.
  defp unharmed(rounds, target, check, make) do
    watch = self()
    limit = setting("SITU_LONG_SCHEDULE", 500)
    monitor = fn -> :erlang.system_monitor(watch, long_schedule: limit) end
    {:ok, monitor} = Agent.start_link(monitor)
    atoms = :erlang.system_info(:atom_count)
    before = resident()

    answers =
      for _ <- 1..rounds, reduce: %{} do
        answers ->
          make.()
          Map.update(answers, ask(target, check), 1, &(&1 + 1))
      end

    :erlang.system_monitor(:undefined)
    Agent.stop(monitor)
    long = for {:monitor, who, :long_schedule, info} <- flush(), do: {who, info}
    assert resident() - before < 256 * 1024
    assert :erlang.system_info(:atom_count) - atoms < 500
    {answers, long}
  end

  @codes ~w(asked damaged missing_extent not_a_store newer_version io no_store index_lost)a

  test "false contents use little memory and block no scheduler", %{tmp_dir: root} do
    path = base(root)
    target = Path.join(root, "lie.0000")
    :rand.seed(:exsss, {1, 2, 3 + setting("SITU_SEED", 0)})
    lies = setting("SITU_LIES", 150)
    {answers, long} = unharmed(lies, target, false, fn -> lie(path, target) end)
    assert Map.keys(answers) -- @codes == []

    # This check is last so that it hides no other failure: a busy machine may block a scheduler, too.
    assert long == []
  end

  test "damaged stores return only written data and block no scheduler", %{tmp_dir: root} do
    path = base(root)

    files =
      for name <- File.ls!(path), name != "lock", do: {name, File.read!(Path.join(path, name))}

    target = Path.join(root, "hurt.0000")
    File.mkdir_p!(target)
    :rand.seed(:exsss, {4, 5, 6 + setting("SITU_SEED", 0)})

    {answers, long} =
      unharmed(setting("SITU_MUTATIONS", 150), target, true, fn ->
        mutate(Map.new(files), target)
      end)

    assert Map.keys(answers) -- @codes == []
    assert answers.asked > 0
    assert long == []
  end

  defp flush do
    receive do
      message -> [message | flush()]
    after
      0 -> []
    end
  end

  # Returns the resident memory of this VM in KiB.
  defp resident do
    [_, kib] = Regex.run(~r/VmRSS:\s+(\d+)/, File.read!("/proc/self/status"))
    String.to_integer(kib)
  end
end
