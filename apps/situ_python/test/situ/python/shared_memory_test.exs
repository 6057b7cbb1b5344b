defmodule Situ.Python.SharedMemoryTest do
  use ExUnit.Case, async: true
  import Bitwise
  alias Situ.Python.SharedMemory

  @moduletag :tmp_dir

  defp write!(memory, bytes) do
    {:ok, slot, memory} = SharedMemory.write_value(memory, bytes, IO.iodata_length(bytes))
    {slot, memory}
  end

  test "reuses slots of a similar size, and is full at its limit", %{tmp_dir: dir} do
    {:ok, memory} = SharedMemory.create_files(dir, 5 * 4_096)
    {a, memory} = write!(memory, ["ab", "cd"])
    {b, memory} = write!(memory, :binary.copy("x", 16_000))
    assert {a.capacity, b.offset, b.capacity} == {4_096, 4_096, 16_384}
    assert SharedMemory.write_value(memory, "full", 4) == :full

    {:ok, memory} = SharedMemory.free_slots(memory, [b.number])
    # The free slot is much larger than the value.
    assert SharedMemory.write_value(memory, "full", 4) == :full
    {again, memory} = write!(memory, :binary.copy("y", 8_000))
    assert {again.number, again.length} == {b.number, 8_000}

    assert {:ok, <<"abcd", 0, _::binary>>} = File.read(Path.join(dir, "in"))
    assert File.stat!(Path.join(dir, "in")).size == 5 * 4_096
    :ok = SharedMemory.close_files(memory)
  end

  test "rejects slots that are not in use, and places outside of the memory", %{tmp_dir: dir} do
    {:ok, memory} = SharedMemory.create_files(dir, 8_192)
    {slot, memory} = write!(memory, "a")
    assert SharedMemory.free_slots(memory, [7]) == :error
    assert SharedMemory.free_slots(memory, [slot.number, slot.number]) == :error

    place = %{number: 0, offset: 0, capacity: 4_096, length: 4}
    assert {:error, _} = SharedMemory.read_value(memory, place)
    File.write!(Path.join(dir, "out"), "1234")
    assert SharedMemory.read_value(memory, place) == {:shared, "1234"}

    for change <- [%{length: 0}, %{length: 5_000}, %{offset: 1 <<< 62}, %{offset: 1 <<< 13}],
        do: assert({:error, _} = SharedMemory.read_value(memory, Map.merge(place, change)))
  end

  # Keeps values in a process of their own, which gives them up as a whole.
  defp keep_values(memory, places) do
    Task.async(fn ->
      kinds = Enum.map(places, fn place -> elem(SharedMemory.read_value(memory, place), 0) end)
      :erlang.garbage_collect()
      kinds
    end)
  end

  test "shares values up to half of the memory, and copies others", %{tmp_dir: dir} do
    {:ok, memory} = SharedMemory.create_files(dir, 16_384)
    File.write!(Path.join(dir, "out"), :binary.copy("x", 16_384))
    place = fn n -> %{number: n, offset: n * 4_096, capacity: 4_096, length: 4_096} end
    held = for n <- 0..2, do: SharedMemory.read_value(memory, place.(n))
    assert [{:shared, a}, {:shared, _}, {:copied, a}] = held
    assert SharedMemory.take_released(memory) == []
    assert byte_size(a) == 4_096
  end

  test "frees a slot when its value has been collected", %{tmp_dir: dir} do
    {:ok, memory} = SharedMemory.create_files(dir, 16_384)
    File.write!(Path.join(dir, "out"), :binary.copy("x", 16_384))
    place = fn n -> %{number: n, offset: n * 4_096, capacity: 4_096, length: 4_096} end
    task = keep_values(memory, [place.(1), place.(3)])
    assert Task.await(task) == [:shared, :shared]
    assert Enum.sort(SharedMemory.take_released(memory)) == [1, 3]
    assert SharedMemory.take_released(memory) == []
  end

  test "keeps the values of a program that truncates its file", %{tmp_dir: dir} do
    {:ok, memory} = SharedMemory.create_files(dir, 65_536)
    File.write!(Path.join(dir, "out"), :binary.copy("x", 65_536))
    place = %{number: 0, offset: 32_768, capacity: 16_384, length: 16_384}
    {:shared, value} = SharedMemory.read_value(memory, place)
    File.write!(Path.join(dir, "out"), "")
    assert value == <<0::size(16_384)-unit(8)>>
    assert {:error, _} = SharedMemory.read_value(memory, place)
  end

  test "returns only a complete journal", %{tmp_dir: dir} do
    {:ok, memory} = SharedMemory.create_files(dir, 4_096)
    assert SharedMemory.read_journal(memory) == {0, <<>>}
    file = File.open!(Path.join(dir, "journal"), [:read, :write, :binary, :raw])
    :ok = :file.pwrite(file, 0, <<5::little-64, 2::little-64, "ab">>)
    assert SharedMemory.read_journal(memory) == {5, "ab"}
    :ok = :file.pwrite(file, 0, <<5::little-64, 1 <<< 50::little-64>>)
    assert SharedMemory.read_journal(memory) == {0, <<>>}
  end
end
