defmodule Situ.Cluster.SealedLogTest do
  # A writer to the log without the cluster's cookie must not be believed.
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.Cluster.{SignedEntry, SealedLog}
  alias Situ.Cluster.Log
  alias Situ.Cluster.Log.Entry
  alias Situ.Test.NatsServer

  @moduletag :tmp_dir
  @adapters if(NatsServer.path(), do: [:folder, :nats], else: [:folder])

  defp open(:folder, dir), do: Log.connect(Path.join(dir, "log"))

  defp open(:nats, dir) do
    server = NatsServer.start(Path.join(dir, "nats"))
    on_exit(fn -> NatsServer.kill(server) end)
    Log.connect(server.url)
  end

  defp entry(i), do: %Entry{op: "w#{i}", head: %{"Last" => "#{i}"}, data: "data #{i}"}

  defp fill(log, subject, range) do
    Enum.reduce(range, 0, fn i, seq ->
      {:ok, seq} = Log.append(log, subject, seq, entry(i))
      seq
    end)
  end

  # Makes one change to an entry, or reads it from another position.
  defp changes do
    one_of([
      {:head, one_of(["Last", "Epoch", "Kind", "Follows"]), integer(0, 9)},
      {:op, integer(0, 9)},
      {:data, integer(0, 30)},
      {:subject, one_of([{:stream, "other"}, {:key, "s"}])},
      {:seq, integer(1, 9)},
      {:run, one_of(["", "another"])}
    ])
  end

  property "rejects an entry that was changed or is read from elsewhere" do
    forall {change, follows} <- {changes(), integer(0, 9)} do
      subject = {:stream, "s"}

      sealed = %{
        SignedEntry.seal_entry(entry(follows), "run", subject, follows)
        | seq: follows + 1
      }

      {changed, run, subject} = change(change, sealed, subject)

      untouched? = changed == sealed and run == "run" and subject == {:stream, "s"}

      case SignedEntry.verify_entry(changed, run, subject) do
        {:ok, %Entry{verified: true} = read} -> untouched? and read.data == "data #{follows}"
        {:behind, _, _} -> false
        {:error, error} -> not untouched? and SignedEntry.refusal?(error)
      end
    end
  end

  defp change({:head, key, value}, entry, subject),
    do: {put_in(entry.head[key], "#{value}"), "run", subject}

  defp change({:op, value}, entry, subject), do: {%{entry | op: "w#{value}"}, "run", subject}
  defp change({:seq, seq}, entry, subject), do: {%{entry | seq: seq}, "run", subject}
  defp change({:run, run}, entry, subject), do: {entry, run, subject}
  defp change({:subject, subject}, entry, _), do: {entry, "run", subject}

  defp change({:data, at}, %{data: data} = entry, subject) do
    at = rem(at, byte_size(data))
    <<before::binary-size(at), byte, rest::binary>> = data
    {%{entry | data: before <> <<Bitwise.bxor(byte, 1)>> <> rest}, "run", subject}
  end

  test "decodes no term of an unverified entry" do
    sealed =
      SignedEntry.seal_entry(
        %Entry{op: "x", data: SignedEntry.encode_term(:term)},
        "run",
        {:key, "k"},
        0
      )

    assert {:error, %{code: :forged_entry}} = SignedEntry.decode_term(sealed)
    {:ok, read} = SignedEntry.verify_entry(%{sealed | seq: 1}, "run", {:key, "k"})
    assert SignedEntry.decode_term(read) == {:ok, :term}
  end

  for adapter <- @adapters do
    describe "#{adapter}" do
      @adapter adapter

      test "sealed entries are read, rewritten and trimmed as usual", %{tmp_dir: dir} do
        {:ok, raw} = open(@adapter, dir)
        log = SealedLog.new(raw, "run")
        subject = {:stream, "s"}
        assert fill(log, subject, 1..5) == 5
        assert Log.append(log, subject, 4, entry(5)) == {:ok, 5}
        assert {:refused, %Entry{seq: 5, verified: true}} = Log.append(log, subject, 3, entry(9))
        :ok = Log.trim(log, subject, 3)
        assert {:ok, entries} = Log.read(log, subject, 1, 9)
        assert for(e <- entries, do: {e.seq, e.data}) == for(i <- 3..5, do: {i, "data #{i}"})

        assert {:ok, 4} =
                 Log.find_position(log, subject, &(Entry.head_integer(&1, "Last", 0) > 3))

        key = {:key, "k"}
        other = {:key, "other"}
        first = fill(log, key, 1..1)
        fill(log, other, 1..3)
        {:ok, _} = Log.append(log, key, first, entry(2))

        assert {:ok, %Entry{data: "data 2", head: %{"Last" => "2"} = head}} =
                 Log.fetch_last(log, key)

        assert map_size(head) == 1
      end

      test "rejects entries of other writers, which never become data", %{tmp_dir: dir} do
        {:ok, raw} = open(@adapter, dir)
        log = SealedLog.new(raw, "run")

        for {kind, n} <- [stream: 1, key: 2] do
          subject = {kind, "s#{n}"}
          last = fill(log, subject, 1..3)

          {:ok, forged} =
            Log.append(raw, subject, last, %Entry{op: "x", head: %{"Epoch" => "999"}})

          assert {:error, %{code: :unsealed_entry} = error} = Log.fetch_last(log, subject)
          assert error.fix =~ "prune"
          assert {:error, _} = Log.append(log, subject, last, entry(4))
          assert {:error, %{code: :unsealed_entry}} = Log.read(log, subject, forged, 1)
        end
      end

      test "rejects an entry that was repeated, moved or copied", %{
        tmp_dir: dir
      } do
        {:ok, raw} = open(@adapter, dir)
        log = SealedLog.new(raw, "run")

        for {kind, n} <- [stream: 1, key: 2] do
          subject = {kind, "s#{n}"}
          first = fill(log, subject, 1..1)
          {:ok, old} = Log.fetch_last(raw, subject)

          last =
            Enum.reduce(2..4, first, fn i, seq ->
              elem(Log.append(log, subject, seq, entry(i)), 1)
            end)

          copy = %{old | seq: nil, op: "copy"}
          # First without the log's own name for the write, then with it.
          {:ok, at} = Log.append(raw, subject, last, copy)
          assert {:error, %{code: :forged_entry}} = Log.fetch_last(log, subject)
          {:ok, _} = Log.append(raw, subject, at, %{old | seq: nil})
          assert {:error, %{code: :forged_entry}} = Log.fetch_last(log, subject)
          {:ok, _} = Log.append(raw, {kind, "elsewhere#{n}"}, 0, %{old | seq: nil})
          assert {:error, %{code: :forged_entry}} = Log.fetch_last(log, {kind, "elsewhere#{n}"})
        end
      end

      test "a later run of the same name rejects entries of an earlier run", %{tmp_dir: dir} do
        {:ok, raw} = open(@adapter, dir)
        subject = {:stream, "s"}
        fill(SealedLog.new(raw, "before"), subject, 1..3)
        {:ok, old} = Log.read(raw, subject, 1, 9)
        :ok = Log.delete(raw, subject)
        log = SealedLog.new(raw, "after")
        fill(log, subject, 1..2)
        third = %{List.last(old) | seq: nil}
        {:ok, 3} = Log.append(raw, subject, 2, third)
        assert {:error, %{code: :forged_entry}} = Log.fetch_last(log, subject)
      end
    end
  end
end
