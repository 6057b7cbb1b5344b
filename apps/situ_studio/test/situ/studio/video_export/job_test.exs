defmodule Situ.Studio.VideoExport.JobTest do
  # A video job reports progress, offers its file, can be cancelled, and ends with its page.
  use ExUnit.Case, async: true

  alias Situ.{Image, Message}
  alias Situ.Studio.{VideoExport, History, Recordings}
  alias Situ.Studio.VideoExport.Job

  setup do
    id = "film-#{System.unique_integer([:positive])}"
    {:ok, studio} = Situ.Studio.start_link(port: 0, id: id)
    on_exit(fn -> Process.exit(studio, :shutdown) end)
    history = History.new(live: false, seconds: 3_600)

    for i <- 0..9 do
      message = %Message{
        data: Image.new_filled(64, 48, :rgb24),
        originating_time: i * 100_000_000
      }

      History.put(history, "Camera", message, 8)
    end

    film = %VideoExport{pictures: "Camera", from: 0, to: 1_000_000_000}
    %{id: id, film: film, source: Recordings.History.wrap(history)}
  end

  test "the file exists until the job is cancelled", %{id: id, film: film, source: source} do
    {:ok, key} = Job.start_job(id, film, source)
    assert_receive {:film, ^key, {:done, bytes}} when bytes > 500, 30_000
    {:ok, path} = Job.fetch_file(id, key)
    assert File.exists?(path)
    assert Job.fetch_file(id, "another") == :error
    :ok = Job.cancel(id, key)
    refute File.exists?(path)
    assert :ok = Job.cancel(id, key)
  end

  test "reports an error, and leaves nothing", %{id: id, film: film, source: source} do
    {:ok, key} = Job.start_job(id, %{film | pictures: "None"}, source)
    assert_receive {:film, ^key, {:error, %Situ.Error{}}}, 30_000
  end

  test "the job ends with the page that requested it", %{id: id, film: film, source: source} do
    test = self()

    page =
      spawn(fn ->
        {:ok, key} = Job.start_job(id, film, source)

        receive do
          {:film, ^key, {:done, _}} -> send(test, {:made, key})
        end

        receive(do: (:close -> :ok))
      end)

    assert_receive {:made, key}, 30_000
    {:ok, path} = Job.fetch_file(id, key)
    [{job, _}] = Registry.lookup(Situ.Studio.Registry, {id, :film, key})
    ref = Process.monitor(job)
    send(page, :close)
    assert_receive {:DOWN, ^ref, :process, _, _}, 30_000
    refute File.exists?(path)
  end
end
