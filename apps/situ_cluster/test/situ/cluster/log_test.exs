defmodule Situ.Cluster.LogTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.Cluster.Log
  alias Situ.Cluster.Log.Entry
  alias Situ.Test.NatsServer

  doctest Situ.Cluster.Log
  doctest Situ.Cluster.Log.Entry

  @moduletag :tmp_dir

  @adapters if(NatsServer.path(), do: [:folder, :nats], else: [:folder])

  if NatsServer.path() == nil do
    IO.puts(
      "no nats-server: its half of the log's tests is not run (bin/setup --for test fetches one)"
    )
  end

  defp open(:folder, dir) do
    {:ok, log} = Log.connect(Path.join(dir, "log"))

    {log,
     fn ->
       {:ok, log} = Log.connect(Path.join(dir, "log"))
       log
     end}
  end

  defp open(:nats, dir) do
    server = NatsServer.start(Path.join(dir, "nats"))
    on_exit(fn -> NatsServer.kill(server) end)
    {:ok, log} = Log.connect(server.url)

    {log,
     fn ->
       {:ok, log} = Log.connect(server.url)
       log
     end}
  end

  defp about(kept, subject), do: Enum.find(kept, &(&1.subject == subject))
  defp entry(op, data \\ "", head \\ %{}), do: %Entry{op: op, data: data, head: head}

  for adapter <- @adapters do
    describe "#{adapter}" do
      @adapter adapter

      test "keeps appended entries in order, also for other clients", %{tmp_dir: dir} do
        {log, again} = open(@adapter, dir)
        subject = {:stream, "a stream/with. odd * names > é"}
        assert {:ok, nil} = Log.fetch_last(log, subject)
        assert {:ok, []} = Log.read(log, subject, 1, 10)

        seqs =
          Enum.scan(1..25, 0, fn i, last ->
            data = :binary.copy(<<i>>, i * 1_000)

            {:ok, seq} =
              Log.append(log, subject, last, entry("op.#{i}", data, %{"Last" => "#{i}"}))

            assert seq > last
            seq
          end)

        other = again.()
        {:ok, entries} = Log.read(other, subject, 1, 100)
        assert for(e <- entries, do: e.seq) == seqs
        assert for(e <- entries, do: Entry.head_integer(e, "Last", 0)) == Enum.to_list(1..25)
        assert List.last(entries).data == :binary.copy(<<25>>, 25_000)
        assert {:ok, %Entry{op: "op.25"}} = Log.fetch_last(other, subject)

        assert {:ok, [%Entry{op: "op.7"}, %Entry{op: "op.8"}]} =
                 Log.read(other, subject, Enum.at(seqs, 6), 2)

        # Other streams may be written in between.
        {:ok, _} = Log.append(other, {:stream, "b"}, 0, entry("b.1"))
        assert {:ok, _} = Log.append(log, subject, List.last(seqs), entry("op.26"))
      end

      test "rejects a writer without the last entry, and a repeated write is one entry", %{
        tmp_dir: dir
      } do
        {log, again} = open(@adapter, dir)

        for subject <- [{:stream, "s"}, {:key, "k"}] do
          {:ok, first} = Log.append(log, subject, 0, entry("a.1"))
          assert {:ok, ^first} = Log.append(again.(), subject, 0, entry("a.1"))
          assert {:refused, %Entry{op: "a.1"}} = Log.append(log, subject, 0, entry("b.1"))
          {:ok, second} = Log.append(log, subject, first, entry("a.2"))

          assert {:refused, %Entry{op: "a.2", seq: ^second}} =
                   Log.append(log, subject, first, entry("b.2"))

          {:ok, third} = Log.append(log, subject, second, entry("a.3"))
          {:ok, fourth} = Log.append(log, subject, third, entry("a.4"))
          # However old its last known entry is.
          for old <- [0, first, second, third],
              do:
                assert(
                  {:refused, %Entry{seq: ^fourth}} =
                    Log.append(log, subject, old, entry("c.#{old}"))
                )
        end
      end

      test "only one of several concurrent appends succeeds", %{tmp_dir: dir} do
        {log, again} = open(@adapter, dir)
        subject = {:key, "lease"}

        Enum.reduce(1..10, 0, fn round, last ->
          answers =
            1..8
            |> Enum.map(fn i -> {i, again.()} end)
            |> Task.async_stream(
              fn {i, log} -> Log.append(log, subject, last, entry("#{round}.#{i}")) end,
              timeout: 60_000
            )
            |> Enum.map(fn {:ok, answer} -> answer end)

          assert [seq] = for({:ok, seq} <- answers, do: seq)
          assert {:ok, %Entry{seq: ^seq}} = Log.fetch_last(log, subject)
          seq
        end)
      end

      test "trims and continues", %{tmp_dir: dir} do
        {log, _} = open(@adapter, dir)
        subject = {:stream, "s"}

        seqs =
          Enum.scan(1..10, 0, fn i, last ->
            elem(Log.append(log, subject, last, entry("#{i}")), 1)
          end)

        :ok = Log.trim(log, subject, Enum.at(seqs, 6))
        {:ok, entries} = Log.read(log, subject, 1, 100)
        assert for(e <- entries, do: e.op) == ~w(7 8 9 10)
        :ok = Log.trim(log, subject, 1_000_000)
        assert {:ok, %Entry{op: "10"}} = Log.fetch_last(log, subject)
        assert {:refused, _} = Log.append(log, subject, 0, entry("x"))
        assert {:ok, _} = Log.append(log, subject, List.last(seqs), entry("11"))
      end

      test "a name of any length and letters is a separate stream", %{tmp_dir: dir} do
        {log, again} = open(@adapter, dir)
        long = String.duplicate("long ", 30)
        longer = String.duplicate("é ", 300)
        names = ["a.b", "a b", "a=20b", "A.b", "é/\\\\*>", long <> "1", long <> "2"]
        names = names ++ [longer <> "1", longer <> "2"]

        for {name, i} <- Enum.with_index(names),
            do: assert({:ok, _} = Log.append(log, {:stream, name}, 0, entry("op.#{i}")))

        for {name, i} <- Enum.with_index(names) do
          op = "op.#{i}"
          assert {:ok, [%Entry{op: ^op}]} = Log.read(again.(), {:stream, name}, 1, 10)
        end

        {:ok, kept} = Log.list_subjects(again.())
        assert Enum.sort(for(%{subject: {:stream, name}} <- kept, do: name)) == Enum.sort(names)
        op = String.duplicate("a long name of a write ", 30)
        assert {:ok, 2} = Log.append(log, {:stream, longer <> "1"}, 1, entry(op))
        assert {:ok, 1} = Log.append(log, {:key, longer}, 0, entry(op))
        assert {:ok, %Entry{op: ^op}} = Log.fetch_last(again.(), {:key, longer})
      end

      test "lists its subjects and deletes them permanently", %{tmp_dir: dir} do
        {log, again} = open(@adapter, dir)
        assert {:ok, []} = Log.list_subjects(log)
        stream = {:stream, "Hall.a stream/with. odd * names > é"}
        long = {:stream, "Hall." <> String.duplicate("long ", 30)}
        key = {:key, "lease.Hall.Sum"}
        before = Situ.Time.now()

        for {subject, s} <- Enum.with_index([stream, long, key]) do
          Enum.reduce(1..3, 0, fn i, last ->
            {:ok, seq} = Log.append(log, subject, last, entry("op.#{s}.#{i}", "12345"))
            seq
          end)
        end

        {:ok, kept} = Log.list_subjects(again.())
        assert Enum.map(kept, & &1.subject) == Enum.sort([stream, long, key])
        assert %{entries: 3, bytes: bytes, written: written} = about(kept, stream)
        assert bytes >= 15
        # The folder's file system counts in whole seconds.
        assert_in_delta written, before, Situ.Time.min(1)
        assert %{entries: 1} = about(kept, key)

        for subject <- [stream, key, {:stream, "Hall.never"}, {:key, "lease.Hall.never"}],
            do: assert(:ok = Log.delete(log, subject))

        assert {:ok, [%{subject: ^long}]} = Log.list_subjects(log)
        assert {:ok, nil} = Log.fetch_last(log, key)
        assert {:ok, []} = Log.read(log, stream, 1, 10)

        for subject <- [stream, key],
            do: assert({:ok, _} = Log.append(log, subject, 0, entry("again")))
      end

      test "finds the first entry that satisfies a condition", %{tmp_dir: dir} do
        {log, _} = open(@adapter, dir)
        subject = {:stream, "s"}
        assert {:ok, nil} = Log.find_position(log, subject, fn _ -> true end)

        Enum.reduce(1..20, 0, fn i, last ->
          {:ok, _} = Log.append(log, {:stream, "other#{i}"}, 0, entry("o#{i}"))
          {:ok, seq} = Log.append(log, subject, last, entry("#{i}", "", %{"Time" => "#{i * 10}"}))
          seq
        end)

        for time <- [0, 10, 11, 95, 200] do
          {:ok, seq} =
            Log.find_position(log, subject, &(Entry.head_integer(&1, "Time", 0) >= time))

          {:ok, [found]} = Log.read(log, subject, seq, 1)
          assert Entry.head_integer(found, "Time", 0) == max(10, div(time + 9, 10) * 10)
        end

        assert {:ok, nil} =
                 Log.find_position(log, subject, &(Entry.head_integer(&1, "Time", 0) >= 201))
      end
    end
  end

  property "an entry survives encoding, and a changed one is rejected" do
    forall {op, data, at} <- {binary(4), binary(), non_neg_integer()} do
      entry = %Entry{op: Base.encode16(op), data: data, head: %{"A" => "1"}}
      bytes = entry |> Entry.encode() |> IO.iodata_to_binary()
      at = rem(at, byte_size(bytes))
      <<before::binary-size(at), byte, rest::binary>> = bytes
      changed = <<before::binary, Bitwise.bxor(byte, 1), rest::binary>>

      Entry.decode(bytes, 3) == {:ok, %{entry | seq: 3}} and
        match?({:error, _}, Entry.decode(changed, 3)) and
        match?({:error, _}, Entry.decode(binary_part(bytes, 0, at), 3))
    end
  end

  test "an address that no log supports is an error" do
    assert {:error, %{code: :bad_address}} = Log.connect("kafka://x")
    assert {:error, %{code: :bad_address}} = Log.connect("nats://secret:x@host:port")
    {:error, error} = Log.connect("nats://user:secret@:1")
    refute error.what =~ "secret"

    assert {:error, %{code: :log_away}} =
             Log.connect("nats://127.0.0.1:#{Situ.Test.FreePort.find_tcp()}")

    assert {:error, %{code: :no_log}} = Log.connect("/proc/nothing/here")
  end
end
