defmodule Situ.Bridge.PsiTest do
  use ExUnit.Case, async: true
  alias Situ.Bridge.Test.Expected
  alias Situ.Test.Budget
  alias Situ.Store

  @data Path.expand("../../data/psi", __DIR__)

  # All stores that \psi's runtime wrote, each with the results of \psi's own reader.
  @stores (for file <- Path.wildcard(Path.join(@data, "**/*expected*.json")) do
             name = Path.basename(file, ".json")
             folder = Path.dirname(file)

             pattern =
               case String.split(name, ".") do
                 ["expected"] -> "*.0000/*"
                 ["expected", version] -> "*.#{version}/*"
                 [store, "expected"] -> "#{store}.0000/*"
               end

             found =
               for at <- [pattern, "*"],
                   catalog <- Path.wildcard(Path.join(folder, at <> ".Catalog_000000.psi")),
                   do: catalog

             path = hd(found)
             {Path.relative_to(file, @data), file, Path.dirname(path)}
           end)

  for {name, file, path} <- @stores do
    test "reads #{name} like \\psi's own reader" do
      {:ok, want} = unquote(file) |> File.read!() |> Situ.JSON.decode()
      store = Store.open!(unquote(path))
      assert Store.info(store).name == want["store"]
      assert Store.closed?(store) == want["isClosed"]

      assert Enum.sort(Enum.map(Store.streams(store), & &1.name)) ==
               Enum.sort(Enum.map(want["streams"], & &1["name"]))

      for stream <- want["streams"], do: stream!(store, stream, want["cut"])
    end
  end

  defp stream!(store, want, cut) do
    {:ok, info} = Store.stream_info(store, want["name"])
    all = store |> Store.messages(info) |> Enum.to_list()

    assert {info.name, info.id, info.count, length(all)} ==
             {want["name"], want["id"], want["messagesRead"], want["messagesRead"]}

    for message <- want["messages"], do: message!(store, message, all, want["name"])
    if want["messageCount"] == length(all), do: statistics!(info, want)
    if cut == nil, do: assert(Situ.Store.StreamInfo.closed?(info) == want["isClosed"])

    if supplemental = want["supplementalMetadata"] do
      {:ok, got} = Store.metadata(store, info)
      Expected.same!(supplemental, got, "metadata of #{want["name"]}")
    else
      assert {:error, %{code: :no_metadata}} = Store.metadata(store, info)
    end
  end

  defp message!(store, want, all, name) do
    got = Enum.find(all, &(&1.sequence_id == want["seq"]))
    assert got, "message #{want["seq"]} of #{name} is missing"
    assert got.originating_time == Expected.ns(want["originatingTime"])
    assert got.creation_time == Expected.ns(want["creationTime"])
    Expected.same!(want["value"], got.data, "message #{want["seq"]} of #{name}")
    assert {:ok, ^got} = Store.first_at(store, name, got.originating_time)
    assert {:ok, ^got} = Store.latest_at(store, name, got.originating_time)
  end

  defp statistics!(%{count: 0} = info, _want), do: assert({info.first, info.last} == {nil, nil})

  defp statistics!(info, want) do
    assert info.size == want["messageSizeCumulativeSum"]
    assert info.latency_sum == want["latencyCumulativeSum"] * 100
    assert info.opened == Expected.ns(want["openedTime"])
    assert info.closed == Expected.ns(want["closedTime"])
    assert info.first == Expected.ns(want["firstMessageOriginatingTime"])
    assert info.last == Expected.ns(want["lastMessageOriginatingTime"])
    assert info.first_creation == Expected.ns(want["firstMessageCreationTime"])
    assert info.last_creation == Expected.ns(want["lastMessageCreationTime"])
  end

  describe "open/2" do
    test "opens a folder or a name, and finds the newest version" do
      assert Store.open!(Path.join(@data, "timing/Timing")) |> Store.info() |> Map.fetch!(:name) ==
               "Timing"

      assert Store.open!(Path.join(@data, "timing/Timing")).path =~ "Timing.0001"
      assert Store.exists?(Path.join(@data, "large"))
      assert {:error, %{code: :no_store}} = Store.open(Path.join(@data, "sessions"))
    end

    test "lists them next to Situ's own stores" do
      found = Store.list(@data, recursive: true)
      assert Path.join(@data, "basics/Basics.0000") in found
      assert Path.join(@data, "sessions/Session2/Robot.0000") in found
      assert length(found) == length(@stores)
    end

    @tag :tmp_dir
    test "opens two stores in one folder by their names", %{tmp_dir: dir} do
      for store <- ["large", "killed"],
          file <- Path.wildcard(Path.join([@data, store, "*.psi"])),
          do: File.cp!(file, Path.join(dir, Path.basename(file)))

      assert Store.list(dir) == [Path.join(dir, "Killed"), Path.join(dir, "Large")]
      assert Store.open!(Path.join(dir, "Large")) |> Store.has_stream?("Blob")
      assert {:error, %{code: :no_store}} = Store.open(dir)
    end

    @tag :tmp_dir
    test "rejects a catalog of another format", %{tmp_dir: dir} do
      File.write!(Path.join(dir, "X.Catalog_000000.psi"), :binary.copy("nothing of ours", 100))
      assert {:error, %{code: :not_psi}} = Store.open(dir)
    end
  end

  describe "info/1" do
    test "reports missing messages, and types known only by their schemas" do
      %{damage: damage} = Store.info(Store.open!(Path.join(@data, "truncated")))
      assert Enum.any?(damage, &(&1 =~ "9 of 10 messages of the stream Small are missing"))
      assert Enum.any?(damage, &(&1 =~ "cut short in the message at byte 27616"))
      %{notes: notes} = Store.info(Store.open!(Path.join(@data, "objects")))
      assert Enum.any?(notes, &(&1 =~ "Reading has the type Sample.Telemetry.Reading"))
    end
  end

  describe "a truncated store" do
    @tag :tmp_dir
    test "opens up to the last complete message, wherever its data end", %{tmp_dir: dir} do
      source = Path.join(@data, "sessions/Session1/Robot.0000")

      for file <- Path.wildcard(Path.join(source, "*")),
          do: File.cp!(file, Path.join(dir, Path.basename(file)))

      data = Path.join(dir, "Robot.Data_000000.psi")
      bytes = File.read!(data)
      whole = all(Store.open!(source))
      ends = ends(bytes)

      for size <- Enum.to_list(0..200) ++ Enum.take_random(201..byte_size(bytes), 100) do
        File.write!(data, binary_part(bytes, 0, size))
        assert length(all(Store.open!(dir))) == Enum.count(ends, &(&1 <= size))
        assert all(Store.open!(dir)) -- whole == []
      end
    end
  end

  defp all(store),
    do: Enum.flat_map(Store.streams(store), &Enum.to_list(Store.messages(store, &1)))

  # Returns where the bytes of each message end, without padding.
  defp ends(bytes), do: ends(bytes, 0)

  defp ends(<<n::little-signed-32, rest::binary>>, at) when n > 0 do
    padded = n + rem(4 - rem(n, 4), 4)
    <<_::binary-size(padded), rest::binary>> = rest
    [at + 4 + n | ends(rest, at + 4 + padded)]
  end

  defp ends(_rest, _at), do: []

  describe "a store built to the reference's rules" do
    alias Situ.Bridge.Test.PsiFiles

    @tag :tmp_dir
    test "with metadata of an old version has their counts", %{tmp_dir: dir} do
      for version <- [0, 1, 2] do
        folder = Path.join(dir, "v#{version}")
        catalog = [PsiFiles.stream(version, "N", 1, "System.Int32, mscorlib", 2)]
        data = for n <- 1..2, do: PsiFiles.message(1, n, PsiFiles.time(n * 100), <<n::little-32>>)
        store = Store.open!(PsiFiles.write!(folder, "old", catalog, data))
        assert {:ok, [%{data: 1}, %{data: 2}]} = Store.read(store, "N")
        assert %{count: 2, size: 8, closed: 2000} = hd(Store.streams(store))
        entry = store.state.catalog.streams[1]
        assert {entry.count, entry.size, entry.latency_ticks} == {2, 8, 60}
      end
    end

    @tag :tmp_dir
    test "has times from the year 1 on, and leaves out invalid ones", %{tmp_dir: dir} do
      catalog = [PsiFiles.stream(2, "N", 1, "System.Int32, mscorlib", 3)]

      bits = [
        0,
        PsiFiles.time(-1_000_000_000_000_000_000),
        3_155_378_975_999_999_999,
        0xFFFF_FFFF_FFFF_FFFF
      ]

      data =
        for {bits, n} <- Enum.with_index(bits, 1),
            do: PsiFiles.message(1, n, bits, <<n::little-32>>)

      path = PsiFiles.write!(Path.join(dir, "far"), "far", catalog, data)
      store = Store.open!(path)

      assert [
               -62_135_596_800_000_000_000,
               -1_000_000_000_000_000_000,
               253_402_300_799_999_999_900
             ] ==
               for(m <- Store.messages(store, "N"), do: m.originating_time)

      assert Enum.any?(Store.info(store).damage, &(&1 =~ "1 messages have an invalid time"))
      assert {:error, %{code: :bad_time}} = Store.copy(path, Path.join(dir, "ours"))
    end
  end

  describe "conversion" do
    @tag :tmp_dir
    test "to Situ's own format keeps all messages", %{tmp_dir: dir} do
      for name <- ["basics/Basics.0000", "objects", "media/Media.0000"] do
        from = Store.open!(Path.join(@data, name))
        target = Path.join(dir, String.replace(name, "/", "-"))
        {:ok, _} = Store.copy(Path.join(@data, name), target)
        to = Store.open!(target)
        for info <- Store.streams(from), do: assert(data(to, info.name) == data(from, info.name))
      end
    end
  end

  describe "conversion to MCAP" do
    @tag :tmp_dir
    test "keeps messages that do not fit the type of the first one", %{tmp_dir: dir} do
      path = Path.join(dir, "basics.mcap")
      basics = Store.open!(Path.join(@data, "basics/Basics.0000"))
      assert {:ok, 227} = Situ.Bridge.Mcap.export(basics, path)
      mcap = Store.open!(path)
      # One value is too large for 64 bits, and one is missing.
      values = fn store, name -> for m <- Store.messages(store, name), do: m.data end
      as_json = fn name -> for %{"value" => value} <- values.(mcap, name), do: value end
      assert as_json.("DateTime") == values.(basics, "DateTime")
      assert nil in as_json.("NullableDouble")
      assert as_json.("NullableDouble") == values.(basics, "NullableDouble")
      assert values.(mcap, "Int") == values.(basics, "Int")

      assert {:error, %{code: :not_writable}} =
               Situ.Bridge.Mcap.export(basics, path, encoding: :ros1, streams: ["DateTime"])
    end
  end

  defp data(store, name),
    do: for(m <- Store.messages(store, name), do: {m.originating_time, m.data})

  describe "damaged and hostile files" do
    @tag :tmp_dir
    @tag timeout: Situ.Test.Budget.time_limit_ms()
    test "open and can be read, or return an error", %{tmp_dir: dir} do
      sources = [
        Path.join(@data, "objects"),
        Path.join(@data, "large"),
        Path.join(@data, "extents")
      ]

      atoms = :erlang.system_info(:atom_count)

      for n <- 1..Budget.mutation_count(300), source = Enum.random(sources) do
        to = Path.join(dir, "s#{rem(n, 3)}")
        File.rm_rf!(to)
        File.mkdir_p!(to)

        for file <- Path.wildcard(Path.join(source, "*.psi")),
            do: File.write!(Path.join(to, Path.basename(file)), mutate(File.read!(file)))

        case Store.open(to) do
          {:ok, store} -> for info <- Store.streams(store), do: {:ok, _} = Store.read(store, info)
          {:error, %Situ.Error{}} -> :ok
        end
      end

      assert :erlang.system_info(:atom_count) - atoms < 5_000
    end
  end

  defp mutate(bytes) do
    Enum.reduce(1..:rand.uniform(4), bytes, fn _, bytes ->
      at = :rand.uniform(byte_size(bytes)) - 1
      <<before::binary-size(at), _, rest::binary>> = bytes
      before <> <<Enum.random([0, 1, 0x7F, 0x80, 0xC0, 0xFF, :rand.uniform(255)])>> <> rest
    end)
  end
end
