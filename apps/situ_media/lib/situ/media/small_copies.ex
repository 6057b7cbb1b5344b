defmodule Situ.Media.SmallCopies do
  @moduledoc false
  # Makes small copies of video files in the background, one at a time, for pages that scrub through a video.
  # See docs/adr/0197-pages-scrub-with-small-copies.md.
  use GenServer

  alias Situ.Media.Recording.OpenFile
  alias Situ.Media.SmallCopy
  alias Situ.Store

  # The copies that were used longest ago are deleted beyond this size.
  @most_bytes 2 * 1024 * 1024 * 1024

  defstruct [:root, :running, :most_bytes, waiting: [], failed: MapSet.new()]

  @type answer :: {:ok, Situ.Recording.t()} | :pending | :none

  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(opts \\ []),
    do: GenServer.start_link(__MODULE__, opts, name: opts[:name] || __MODULE__)

  @doc """
  Returns the small copy of a file's images: a recording with a stream of the same name. Returns `:pending` while it is
  being made, and `:none` if that is not possible.
  """
  @spec fetch(OpenFile.t(), GenServer.server()) :: answer()
  def fetch(recording, server \\ __MODULE__), do: GenServer.call(server, {:fetch, recording})

  @impl true
  def init(opts) do
    Process.flag(:trap_exit, true)
    root = opts[:root] || cache_folder()
    {:ok, %__MODULE__{root: root, most_bytes: opts[:most_bytes] || @most_bytes}}
  end

  defp cache_folder,
    do: System.get_env("SITU_SMALL_COPIES") || :filename.basedir(:user_cache, "situ/small-copies")

  @impl true
  def handle_call({:fetch, %OpenFile{info: %{video: nil}}}, _from, state),
    do: {:reply, :none, state}

  def handle_call({:fetch, recording}, _from, state) do
    name = copy_name(recording)
    folder = Path.join(state.root, name)

    cond do
      File.dir?(folder) -> {:reply, open_copy(folder), state}
      MapSet.member?(state.failed, name) -> {:reply, :none, state}
      true -> {:reply, :pending, state |> add_waiting(name, recording) |> start_next()}
    end
  end

  @impl true
  def handle_info({:EXIT, task, reason}, %{running: {task, name}} = state) do
    failed = if reason == :normal, do: state.failed, else: MapSet.put(state.failed, name)
    {:noreply, start_next(%{state | running: nil, failed: failed})}
  end

  def handle_info(_other, state), do: {:noreply, state}

  # A file that changes gets another copy.
  defp copy_name(recording) do
    key = :erlang.term_to_binary({recording.path, recording.version, recording.print})
    :crypto.hash(:sha256, key) |> binary_part(0, 16) |> Base.encode16(case: :lower)
  end

  # The folder's time is the time of the last use.
  defp open_copy(folder) do
    _ = File.touch(folder)

    case Store.open(folder) do
      {:ok, store} -> {:ok, store}
      {:error, _} -> :none
    end
  end

  defp add_waiting(%{running: {_, name}} = state, name, _recording), do: state

  defp add_waiting(state, name, recording) do
    if List.keymember?(state.waiting, name, 0),
      do: state,
      else: %{state | waiting: state.waiting ++ [{name, recording}]}
  end

  defp start_next(%{running: nil, waiting: [{name, recording} | waiting]} = state) do
    {:ok, task} = Task.start_link(fn -> make_copy(state, name, recording) end)
    %{state | running: {task, name}, waiting: waiting}
  end

  defp start_next(state), do: state

  # A copy gets its name when it is complete.
  defp make_copy(%{root: root} = state, name, recording) do
    File.mkdir_p!(root)
    delete_oldest(state)
    # Another program may be making the same copy.
    unfinished = Path.join(root, "#{name}.#{System.pid()}.unfinished")
    _ = File.rm_rf!(unfinished)

    with :ok <- SmallCopy.write_copy(recording, unfinished),
         :ok <- File.rename(unfinished, Path.join(root, name)) do
      :ok
    else
      {:error, _reason} ->
        _ = File.rm_rf!(unfinished)
        exit({:shutdown, :no_copy})
    end
  end

  defp delete_oldest(%{root: root, most_bytes: most}) do
    root
    |> File.ls!()
    |> Enum.map(&Path.join(root, &1))
    |> Enum.sort_by(&File.stat!(&1).mtime, :desc)
    |> Enum.reduce(0, fn folder, bytes ->
      bytes = bytes + folder_size(folder)
      if bytes > most, do: File.rm_rf!(folder)
      bytes
    end)
  end

  defp folder_size(folder) do
    for path <- Path.wildcard(Path.join(folder, "*")),
        {:ok, %{size: size}} <- [File.stat(path)],
        reduce: 0 do
      bytes -> bytes + size
    end
  end
end
