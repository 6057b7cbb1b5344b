defmodule Situ.EditLogTest do
  # Checks the layer of edits with random edits of several writers that crash at any write.
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.EditLog
  alias Situ.EditLog.{Changes, Disk, Document, DocumentHistory, JsonFormat, LockCheck}

  doctest Situ.EditLog.Changes
  doctest Situ.EditLog.Description
  doctest Situ.EditLog.Lines
  doctest Situ.EditLog.LockCheck

  @moduletag :tmp_dir

  defp documents do
    named = list({one_of(~w(a b c d e)), integer(0, 3)})

    {named, list(one_of(~w(x y z))),
     list({one_of(~w(k l m)), one_of([1, "t", nil, [1], %{"a" => 1}])})}
  end

  defp build({named, tags, members}) do
    items = for {name, n} <- Enum.uniq_by(named, &elem(&1, 0)), do: %{"name" => name, "n" => n}
    %{"items" => items, "tags" => Enum.uniq(tags), "metadata" => Map.new(members)}
  end

  property "changes turn one document into another, and back" do
    forall {a, b} <- {documents(), documents()} do
      {a, b} = {build(a), build(b)}
      changes = Changes.diff(a, b)
      assert Enum.all?(changes, &Changes.change?/1)
      {:ok, decoded} = changes |> Situ.JSON.encode() |> Situ.JSON.decode()
      assert Changes.apply_all(a, decoded) == {:ok, b}
      assert Changes.apply_all(b, Changes.invert(decoded)) == {:ok, a}
    end
  end

  property "changes of two writers at different places commute" do
    forall {a, b, c} <- {documents(), documents(), documents()} do
      [a, b, c] = Enum.map([a, b, c], &(&1 |> build() |> sort_lists()))
      {one, two} = {Changes.diff(a, b), Changes.diff(a, c)}

      with {:ok, x} <- Changes.apply_all(b, two), {:ok, y} <- Changes.apply_all(c, one) do
        assert sort_lists(x) == sort_lists(y)
      else
        {:conflict, _} -> true
      end
    end
  end

  defp sort_lists(json),
    do: %{
      json
      | "items" => Enum.sort_by(json["items"], & &1["name"]),
        "tags" => Enum.sort(json["tags"])
    }

  # An edit is {writer, key, crash}: the writer sets its own member `key` to the next number. A crash happens at the
  # n-th step on the disk, before it or in the middle of it, or the disk is full.
  defp edits do
    list(
      {integer(1, 3), one_of(~w(k l m)),
       one_of([:none, {integer(1, 3), one_of([:before, :middle, :full])}])}
    )
  end

  # With SITU_TIMES, thousands of edits are synced to disk.
  @tag timeout: 3_600_000
  property "crashes at any step lose no acknowledged edit", context: %{tmp_dir: root} do
    forall edits <- edits() do
      path = Path.join(root, "d#{System.unique_integer([:positive])}.json")
      File.write!(path, ~s({"metadata": {}}))

      {written, doubtful, _} =
        edits |> Enum.with_index(1) |> Enum.reduce({%{}, [], %{}}, &edit_once(&1, &2, path))

      {:ok, document} = Document.open(path, JsonFormat)
      found = document.content["metadata"]

      for key <- Map.keys(Map.merge(found, written)) do
        assert found[key] in [
                 written[key] | for({^key, n} <- doubtful, n > (written[key] || 0), do: n)
               ]
      end

      # The file itself is complete after the next edit.
      {:ok, document} = Document.edit(document, &{:ok, put_in(&1["metadata"]["end"], 1)})
      {:ok, text} = Situ.JSON.decode(File.read!(path))
      assert text["metadata"] == document.content["metadata"]
      {:ok, entries} = DocumentHistory.list_entries(document)
      assert Enum.map(entries, & &1.n) == Enum.to_list(1..length(entries)//1)
    end
  end

  defp edit_once({{writer, name, crash}, n}, {written, doubtful, open}, path) do
    key = "#{name}#{writer}"
    document = open[writer] || elem(Document.open(path, JsonFormat), 1)

    case run_edit(document, {key, n}, crash) do
      {:ok, document} -> {Map.put(written, key, n), doubtful, Map.put(open, writer, document)}
      {:error, %{code: :not_saved}} -> {written, doubtful, open}
      :crashed -> {written, [{key, n} | doubtful], Map.delete(open, writer)}
    end
  end

  # A crashed writer is a process that ends, so its lock is released.
  defp run_edit(document, {key, n}, crash) do
    task =
      Task.async(fn ->
        put_crash(crash)

        try do
          Document.edit(document, &{:ok, put_in(&1["metadata"][key], n)})
        catch
          :crashed -> :crashed
        end
      end)

    Task.await(task)
  end

  defp put_crash(:none), do: :ok

  defp put_crash({step, how}) do
    steps = :counters.new(1, [])

    Disk.put_fault(fn {kind, path, bytes} ->
      :counters.add(steps, 1, 1)
      if :counters.get(steps, 1) == step, do: fail_step(how, {kind, path, bytes}), else: :ok
    end)
  end

  defp fail_step(:before, _step), do: throw(:crashed)
  defp fail_step(:full, _step), do: {:error, :enospc}

  # A part of the bytes reaches the disk.
  defp fail_step(:middle, {:append, path, bytes}) do
    File.write!(path, binary_part(bytes, 0, div(byte_size(bytes), 2)), [:append])
    throw(:crashed)
  end

  defp fail_step(:middle, {:replace, path, bytes}) do
    File.write!(path <> ".1.tmp", binary_part(bytes, 0, div(byte_size(bytes), 2)))
    throw(:crashed)
  end

  describe "a log" do
    setup %{tmp_dir: root} do
      path = Path.join(root, "layout.json")
      File.write!(path, ~s({"a": 1}))
      {:ok, document} = Document.open(path, JsonFormat)
      {:ok, document} = Document.edit(document, &{:ok, Map.put(&1, "b", 2)})
      %{document: document, log: path <> ".edits", path: path}
    end

    test "without a file system that locks is refused", %{tmp_dir: root} do
      # Two programs that lock different files never exclude each other, like on such a file system.
      unlocked = fn path -> Situ.Store.FileLock.acquire(path <> "-#{System.unique_integer()}") end
      folder = Path.join(root, "share")
      File.mkdir_p!(folder)
      # The device is known already, so the check is repeated.
      {:ok, %{major_device: device}} = File.stat(folder)
      :persistent_term.erase({LockCheck, device})
      assert {:error, %{code: :no_locks, fix: fix}} = LockCheck.check_folder(folder, unlocked)
      assert fix =~ "local disk"

      unsupported = fn path ->
        Situ.Store.NativeErrors.wrap_error(
          {:error, {:io, "lock", 37, "No locks available"}},
          path
        )
      end

      assert {:error, %{code: :no_locks, why: "No locks available", fix: ^fix}} =
               LockCheck.check_folder(folder, unsupported)

      assert LockCheck.check_folder(folder) == :ok
    end

    test "with a torn last line continues", %{document: document, log: log, path: path} do
      File.write!(log, "12345678 {\"n\":2,\"kind\":\"edit\"", [:append])
      {:ok, document} = Document.edit(document, &{:ok, Map.put(&1, "c", 3)})
      File.write!(log, "00000000 {\"n\":3}\n", [:append])
      assert {:ok, %{content: %{"b" => 2, "c" => 3}}} = Document.open(path, JsonFormat)
      {:ok, _} = Document.edit(document, &{:ok, Map.put(&1, "d", 4)})
      assert {:ok, %{content: %{"d" => 4}}} = Document.open(path, JsonFormat)
    end

    test "that was deleted or damaged is reported or started again", context do
      %{document: document, log: log, path: path} = context
      text = File.read!(log)
      File.rm!(log)
      {:ok, document} = Document.edit(document, &{:ok, Map.put(&1, "c", 3)})
      assert %{"a" => 1, "b" => 2, "c" => 3} = document.content
      assert {:ok, %{log: %{n: 1}}} = Document.open(path, JsonFormat)
      File.write!(log, String.replace(text, "edit", "edid") <> "x\n")
      assert {:error, %{code: :bad_log}} = Document.open(path, JsonFormat)
    end

    test "of a deleted file brings the content back", %{document: document, path: path} do
      File.rm!(path)
      {:ok, _} = Document.edit(document, &{:ok, Map.put(&1, "c", 3)})
      assert {:ok, %{content: %{"b" => 2, "c" => 3}}} = Document.open(path, JsonFormat)
    end

    test "on a full disk loses nothing that was acknowledged", %{document: document, path: path} do
      Disk.put_fault(fn _ -> {:error, :enospc} end)
      edit = fn document -> Document.edit(document, &{:ok, Map.put(&1, "c", 3)}) end
      assert {:error, %{code: :not_saved, why: "no space left on device"}} = edit.(document)
      # There is space for the log but not for the file.
      Disk.put_fault(fn {kind, _, _} -> if kind == :replace, do: {:error, :enospc}, else: :ok end)
      assert {:ok, _} = edit.(document)
      Disk.put_fault(nil)
      assert {:ok, %{content: %{"b" => 2, "c" => 3}}} = Document.open(path, JsonFormat)
    end

    test "names who holds the lock", %{path: path} do
      {:ok, lock} = Situ.Store.FileLock.acquire(path <> ".lock")
      assert {:error, %{code: :in_use, why: why}} = EditLog.with_lock(path, fn -> :never end, 0)
      assert why =~ "process #{System.pid()}"
      Situ.Store.FileLock.release(lock)
    end
  end
end
