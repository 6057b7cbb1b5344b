defmodule Situ.Dataset.Derivation.RunJournal do
  @moduledoc false
  # Records the start and end of a run's sessions, one line of JSON each, on disk before the run continues. The next
  # run of the same output keeps the completed sessions and deletes the output of incomplete ones.
  #
  # A pipeline over a hundred sessions takes hours, and may be cancelled, killed, or fail for
  # single sessions. Output folders are named `NAME.*.unfinished` and renamed when their pipeline
  # has succeeded, so a journal line and a rename are enough to resume. Each session runs in a
  # separate process, and a cancelled run kills these processes.
  alias Situ.Dataset.StoreVersion
  alias Situ.Error

  defstruct [:path]
  @type t :: %__MODULE__{path: Path.t() | nil}

  @doc """
  Opens the journal and returns it with the completed sessions of an earlier run, `%{session => {folder,
  provenance}}`. With `overwrite:`, the results of a run that ended normally (with failed sessions) are ignored.
  """
  @spec open(Path.t() | nil, String.t() | nil, keyword()) ::
          {t(), %{String.t() => {Path.t(), map() | nil}}}
  def open(file, output, _opts) when file == nil or output == nil, do: {%__MODULE__{}, %{}}

  def open(file, output, opts) do
    path = "#{file}.#{String.replace(output, ~r/[^\w.-]/u, "_")}.run"
    lines = read_entries(path)

    done =
      for %{"done" => session, "path" => folder} = line <- lines,
          into: %{},
          do: {session, {folder, line["provenance"]}}

    for %{"begun" => _, "draft" => draft} <- lines,
        is_binary(draft),
        do: StoreVersion.discard_draft(draft)

    log = %__MODULE__{path: path}

    over? = Enum.any?(lines, &is_map_key(&1, "ended"))

    if opts[:resume] and not (over? and opts[:overwrite]),
      do: {log, done},
      else: {remove(log), %{}}
  end

  # The last line may be truncated.
  defp read_entries(path) do
    case File.read(path) do
      {:ok, text} ->
        for line <- String.split(text, "\n"),
            {:ok, %{} = entry} <- [Situ.JSON.decode(line)],
            do: entry

      {:error, _} ->
        []
    end
  end

  @spec record_start(t(), String.t(), Path.t() | nil) :: :ok | {:error, Error.t()}
  def record_start(log, session, draft), do: append_entry(log, %{begun: session, draft: draft})

  @spec record_done(t(), String.t(), {Path.t(), map() | nil}) :: :ok | {:error, Error.t()}
  def record_done(log, session, {folder, provenance}),
    do: append_entry(log, %{done: session, path: folder, provenance: provenance})

  @doc "Records that the run ended although some sessions were not completed."
  @spec record_end(t()) :: :ok | {:error, Error.t()}
  def record_end(log), do: append_entry(log, %{ended: true})

  defp append_entry(%{path: nil}, _entry), do: :ok

  defp append_entry(%{path: path}, entry) do
    # The leading line feed separates the entry from a line that a crash truncated.
    line = ["\n", Situ.JSON.encode(entry), "\n"]

    with {:ok, device} <- :file.open(path, [:append, :raw, :binary]),
         :ok <- :file.write(device, line),
         :ok <- :file.datasync(device) do
      :file.close(device)
    else
      {:error, reason} ->
        {:error,
         Error.new(:not_saved, "cannot write #{path}",
           why: to_string(:file.format_error(reason)),
           fix: "free disk space or check the folder; the run writes its journal there"
         )}
    end
  end

  @spec remove(t()) :: t()
  def remove(%{path: nil} = log), do: log

  def remove(%{path: path} = log) do
    _ = File.rm(path)
    log
  end
end
