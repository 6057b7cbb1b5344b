defmodule Situ.Store.MovePlan do
  @moduledoc false
  # The plan of a move (`Situ.Store.Moving`), which is a file `NAME.moving` in both folders until the move has ended.
  alias Situ.Error
  alias Situ.Store.{AtomicFile, Folder}

  @suffix ".moving"

  @typedoc """
  A move of entries from the folder `from` to the folder `to`. `staged` maps entries to the names of their copies in
  `to`, if that is another file system.
  """
  @type t :: %{
          from: Path.t(),
          to: Path.t(),
          name: String.t(),
          entries: [String.t()],
          staged: %{String.t() => String.t()}
        }

  @doc "Writes the plan to a folder."
  @spec write_note(t(), Path.t()) :: :ok | {:error, Error.t()}
  def write_note(plan, root) do
    path = note_path(root, plan.name)

    case AtomicFile.write(path, Situ.JSON.encode(plan)) do
      :ok -> :ok
      {:error, reason} -> {:error, Folder.io_error("write #{path}", reason)}
    end
  end

  @doc "Deletes the plan from a folder."
  @spec delete_note(t(), Path.t()) :: :ok | {:error, Error.t()}
  def delete_note(plan, root) do
    path = note_path(root, plan.name)

    case File.rm(path) do
      {:error, reason} when reason != :enoent ->
        {:error, Folder.io_error("delete #{path}", reason)}

      _ ->
        AtomicFile.sync_folder(root)
    end
  end

  defp note_path(root, name), do: Path.join(root, name <> @suffix)

  @doc "Returns the interrupted move from or to `path`, or `nil`."
  @spec find_interrupted(Path.t()) :: t() | nil
  def find_interrupted(path) do
    with {:ok, text} <- File.read(path <> @suffix),
         {:ok, %{} = json} <- Situ.JSON.decode(text),
         do: parse_plan(json),
         else: (_ -> nil)
  end

  defp parse_plan(%{
         "from" => from,
         "to" => to,
         "name" => name,
         "entries" => entries,
         "staged" => %{} = staged
       })
       when is_binary(from) and is_binary(to) and is_list(entries) do
    names = [name | entries] ++ Map.values(staged)

    if Enum.all?(names, &(Folder.check_name(&1) == :ok)),
      do: %{from: from, to: to, name: name, entries: entries, staged: staged}
  end

  defp parse_plan(_), do: nil

  @doc """
  Returns the interrupted move of `path` to `folder`. ROOT/NAME may mean the version that was moving, which may be in
  the other folder by now.
  """
  @spec find_plan(Path.t(), Path.t()) :: t() | nil
  def find_plan(path, folder) do
    name = Path.basename(path)

    for root <- [Path.dirname(path), folder],
        {:ok, entries} <- [File.ls(root)],
        entry <- entries,
        String.ends_with?(entry, @suffix),
        moving = String.replace_suffix(entry, @suffix, ""),
        moving == name or Folder.store_name(moving) == name,
        %{from: from} = plan <- [find_interrupted(Path.join(root, moving))],
        from == Path.dirname(path) do
      plan
    end
    |> List.first()
  end

  @doc "Returns the error about an interrupted move."
  @spec interrupted_error(t()) :: Error.t()
  def interrupted_error(plan) do
    path = Path.join(plan.from, plan.name)

    Error.new(:move_interrupted, "the recording #{path} is being moved to #{plan.to}",
      why: "some of its files may still be in the old folder",
      fix: "if no program is moving it, complete it with `situ store move '#{path}' '#{plan.to}'`"
    )
  end
end
