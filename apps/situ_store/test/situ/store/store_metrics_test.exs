defmodule Situ.Store.StoreMetricsTest do
  use ExUnit.Case, async: false
  import Situ.Test.Eventually
  alias Situ.Store.{OpenRecordings, StoreMetrics}

  @moduletag :tmp_dir
  @moduletag :capture_log

  defp start(name, folder, opts) do
    {:ok, p} =
      Situ.Pipeline.start(
        fn p ->
          store = Situ.Store.create(p, name, folder, opts)
          numbers = Situ.from_enumerable(p, 1..2_000, every: Situ.Time.ms(1), keep_open: true)
          Situ.Store.write(numbers, store, "Numbers")
        end,
        pipeline: [replay: [speed: :max]]
      )

    p
  end

  # A reference to a writer holds its lock, which a recorder that starts again must find free.
  test "does not hold the lock of a store whose process was killed", %{tmp_dir: folder} do
    p = start("Metrics lock", folder, [])
    await_bytes("Metrics lock")
    path = Path.join(folder, "Metrics lock.0000")
    assert %{"Metrics lock" => _} = OpenRecordings.list_recordings()
    :sys.suspend(OpenRecordings)
    Process.exit(p, :kill)

    assert eventually(fn ->
             {:ok, store} = Situ.Store.open(path)
             not Situ.Store.live?(store)
           end)

    :sys.resume(OpenRecordings)
  end

  defp await_bytes(name, least \\ 8_000) do
    eventually(fn ->
      bytes = OpenRecordings.list_recordings()[name]
      bytes && bytes > least && bytes
    end)
  end

  defp await_absence(name),
    do: assert(eventually(fn -> not is_map_key(OpenRecordings.list_recordings(), name) end))

  test "counts the bytes of a recording until it is closed", %{tmp_dir: folder} do
    assert StoreMetrics in Application.get_env(:situ_store, :metrics)
    p = start("Metrics single", folder, [])
    bytes = await_bytes("Metrics single")
    assert bytes < 2_000 * 40
    text = Situ.Metrics.to_text(StoreMetrics.collect_metrics())
    assert text =~ ~r/situ_store_written_bytes_total\{store="Metrics single"\} \d+\n/
    {:ok, _} = Situ.Pipeline.stop(p)
    await_absence("Metrics single")
  end

  test "counts earlier segments, too", %{tmp_dir: folder} do
    p = start("Metrics segments", folder, split: Situ.Time.ms(100))

    # A segment has 100 messages and less than 5,000 bytes, and only the last two segments are open.
    assert await_bytes("Metrics segments", 20_000)
    {:ok, _} = Situ.Pipeline.stop(p)
    await_absence("Metrics segments")
  end

  test "forgets the recordings of a pipeline that was killed", %{tmp_dir: folder} do
    p = start("Metrics killed", folder, [])
    await_bytes("Metrics killed")
    Process.exit(p, :kill)
    await_absence("Metrics killed")
  end
end
