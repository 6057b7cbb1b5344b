defmodule Situ.Studio.VideoExport.Job do
  @moduledoc false
  # Exports one video, or one page as HTML, for one page: reports the progress to the page, keeps the file until the
  # page is closed, and can be cancelled. The page receives `{:film, key, event}`, where `event`
  # is `{:progress, part}`, `{:done, bytes}` or `{:error, error}`.
  use GenServer, restart: :temporary

  alias Situ.Studio.{Catalog, PageExport, VideoExport}

  @type work :: VideoExport.t() | PageExport.t()

  @doc "Starts an export for the calling process. Returns the key for fetching the finished file."
  @spec start_job(Catalog.id(), work(), Situ.Recording.t()) :: {:ok, String.t()}
  def start_job(studio, film, source) do
    key = Base.url_encode64(:crypto.strong_rand_bytes(18))
    args = %{studio: studio, key: key, film: film, source: source, page: self()}
    {:ok, _} = DynamicSupervisor.start_child(Catalog.watch_supervisor(studio), {__MODULE__, args})
    {:ok, key}
  end

  @doc "Cancels the export and deletes its output."
  @spec cancel(Catalog.id(), String.t()) :: :ok
  def cancel(studio, key) do
    case Registry.lookup(Situ.Studio.Registry, {studio, :film, key}) do
      [{pid, _}] -> GenServer.stop(pid)
      [] -> :ok
    end
  catch
    :exit, _ -> :ok
  end

  @doc "Fetches the path of the finished file."
  @spec fetch_file(Catalog.id(), term()) :: {:ok, Path.t()} | :error
  def fetch_file(studio, key) do
    case Registry.lookup(Situ.Studio.Registry, {studio, :film, key}) do
      [{_, path}] when is_binary(path) -> {:ok, path}
      _ -> :error
    end
  end

  @doc false
  def start_link(args), do: GenServer.start_link(__MODULE__, args)

  @impl true
  def init(%{key: key, page: page} = args) do
    Process.flag(:trap_exit, true)
    {:ok, _} = Registry.register(Situ.Studio.Registry, {args.studio, :film, key}, nil)
    Process.monitor(page)
    folder = Situ.Error.unwrap!(Situ.TempFolder.create_folder("film"))
    path = Path.join(folder, "selection." <> file_ending(args.film))
    job = self()
    %{film: film, source: source} = args

    {:ok, task} =
      Task.start_link(fn ->
        tell = &send(page, {:film, key, {:progress, &1}})
        send(job, {:written, write_file(film, source, path, tell)})
      end)

    {:ok, %{args: args, task: task, folder: folder, path: path}}
  end

  @doc "Returns the ending of the file's name."
  @spec file_ending(work()) :: String.t()
  def file_ending(%VideoExport{}), do: "mp4"
  def file_ending(%PageExport{}), do: "html"

  defp write_file(%VideoExport{} = film, source, path, tell),
    do: VideoExport.write_video(film, source, path, tell)

  defp write_file(%PageExport{} = page, source, path, tell) do
    with {:ok, _bytes, _notes} <- PageExport.write_page(page, source, path, tell), do: :ok
  end

  @impl true
  def handle_info({:written, :ok}, %{args: args, path: path} = state) do
    Registry.update_value(Situ.Studio.Registry, {args.studio, :film, args.key}, fn _ -> path end)
    notify_page(state, {:done, File.stat!(path).size})
    {:noreply, state}
  end

  def handle_info({:written, {:error, error}}, state) do
    notify_page(state, {:error, error})
    {:stop, :normal, state}
  end

  # The page that requested the video was closed.
  def handle_info({:DOWN, _, :process, _, _}, state), do: {:stop, :normal, state}

  def handle_info({:EXIT, task, reason}, %{task: task} = state) when reason != :normal do
    error =
      Situ.Error.new(:film_failed, "the file could not be created", why: inspect(reason, limit: 8))

    notify_page(state, {:error, error})
    {:stop, :normal, state}
  end

  def handle_info(_, state), do: {:noreply, state}

  defp notify_page(%{args: %{page: page, key: key}}, progress),
    do: send(page, {:film, key, progress})

  # The encoder is linked to the task and ends with it.
  @impl true
  def terminate(_reason, %{task: task, folder: folder}) do
    Process.exit(task, :kill)
    Situ.TempFolder.remove_folder(folder)
  end
end
