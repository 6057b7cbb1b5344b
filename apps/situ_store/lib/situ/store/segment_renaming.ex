defmodule Situ.Store.SegmentRenaming do
  @moduledoc false
  # Renames all segments of a recording. During that time, a file `NAME.renaming` exists for the old and for the new
  # name, so a program that opens either of them learns that the recording is incomplete. If the program is killed,
  # the files describe how to complete the renaming.
  alias Situ.Error
  alias Situ.Store.{AtomicFile, Folder, Native, NativeErrors, Segments}

  @suffix ".renaming"

  @typedoc "A renaming in the folder `root`."
  @type plan :: %{root: Path.t(), from: String.t(), to: String.t()}

  @doc "Renames the segments of `path`: `{:ok, new_path}`."
  @spec rename_segments(Path.t(), String.t()) :: {:ok, Path.t()} | {:error, Error.t()}
  def rename_segments(path, name) do
    plan = %{root: Path.dirname(path), from: Path.basename(path), to: name}

    with :ok <- Folder.check_name(name),
         :ok <- check_free(plan),
         do: run_steps(plan)
  end

  defp check_free(%{from: name, to: name}), do: :ok

  defp check_free(%{root: root, to: to}) do
    case Folder.list_versions(to, root) do
      [] ->
        :ok

      [version | _] ->
        {:error,
         Error.new(:store_exists, "#{Path.join(root, to)} exists",
           why: "#{Path.basename(version)} has that name, and segments keep their numbers",
           fix: "choose another name, or rename that recording first"
         )}
    end
  end

  defp run_steps(plan) do
    Enum.reduce_while(list_steps(plan), {:ok, Path.join(plan.root, plan.to)}, fn step, done ->
      case run_step(step, plan) do
        :ok -> {:cont, done}
        error -> {:halt, error}
      end
    end)
  end

  @doc "Returns the steps of a renaming, in order. A program may be killed between any two of them."
  @spec list_steps(plan()) :: [term()]
  def list_steps(%{from: name, to: name}), do: []

  def list_steps(%{root: root, from: from, to: to}) do
    renames =
      for folder <- Segments.list_possible_folders(Path.join(root, from)),
          do: {:rename, folder, Path.join(root, to <> "." <> version_text(folder))}

    [{:note, to}, {:note, from}] ++ renames ++ [{:forget, from}, {:forget, to}]
  end

  defp version_text(folder), do: folder |> Path.basename() |> String.split(".") |> List.last()

  @doc "Performs a step."
  @spec run_step(term(), plan()) :: :ok | {:error, Error.t()}
  def run_step({:note, name}, plan) do
    path = note_path(plan.root, name)

    case AtomicFile.write(path, Situ.JSON.encode(%{from: plan.from, to: plan.to})) do
      :ok -> :ok
      {:error, reason} -> {:error, Folder.io_error("write #{path}", reason)}
    end
  end

  def run_step({:rename, from, to}, plan) do
    case Native.rename_new(from, to) do
      :ok -> sync(plan)
      :exists -> {:error, Folder.io_error("rename #{from} to #{to}", :eexist)}
      :unsupported -> rename_plain(from, to, plan)
      {:error, reason} -> {:error, NativeErrors.to_error(reason, from)}
    end
  end

  def run_step({:forget, name}, plan) do
    path = note_path(plan.root, name)

    case File.rm(path) do
      {:error, reason} when reason != :enoent ->
        {:error, Folder.io_error("delete #{path}", reason)}

      _ ->
        sync(plan)
    end
  end

  defp sync(%{root: root}) do
    AtomicFile.sync_folder(root)
    :ok
  end

  defp rename_plain(from, to, plan) do
    case AtomicFile.rename_synced(from, to) do
      :ok -> sync(plan)
      {:error, reason} -> {:error, Folder.io_error("rename #{from}", reason)}
    end
  end

  defp note_path(root, name), do: Path.join(root, name <> @suffix)

  @doc "Returns the interrupted renaming from or to `path`, or `nil`."
  @spec find_interrupted(Path.t()) :: plan() | nil
  def find_interrupted(path) do
    root = Path.dirname(path)

    with {:ok, text} <- File.read(path <> @suffix),
         {:ok, %{"from" => from, "to" => to}} <- Situ.JSON.decode(text),
         :ok <- Folder.check_name(from),
         :ok <- Folder.check_name(to) do
      %{root: root, from: from, to: to}
    else
      _ -> nil
    end
  end

  @doc "Returns the error about an interrupted renaming."
  @spec interrupted_error(plan()) :: Error.t()
  def interrupted_error(%{root: root, from: from, to: to}) do
    Error.new(
      :rename_interrupted,
      "the recording #{Path.join(root, from)} is being renamed to #{to}",
      why: "some of its segments still have the old name",
      fix:
        "if no program is renaming it, complete it with `situ store repair '#{Path.join(root, to)}'`"
    )
  end

  @doc "Completes an interrupted renaming: `{:ok, new_path}`."
  @spec complete(plan()) :: {:ok, Path.t()} | {:error, Error.t()}
  def complete(plan), do: run_steps(plan)
end
