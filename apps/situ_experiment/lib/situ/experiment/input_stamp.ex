defmodule Situ.Experiment.InputStamp do
  @moduledoc false
  # Identifies the contents of a session's recordings. Small recordings and sealed ones are identified by a checksum of
  # their bytes; large ones by the names, sizes and times of their files, because reading terabytes would take longer
  # than the experiment.
  alias Situ.Dataset.{Checksum, Partition, Session, StoredPath}
  alias Situ.Experiment.CodeVersion

  @most_bytes 16_000_000

  @doc "Returns a stamp for each partition of a session."
  @spec partition_stamps(Session.t()) :: %{String.t() => String.t()}
  def partition_stamps(%Session{partitions: partitions}),
    do: Map.new(partitions, &{&1.name, stamp_partition(&1)})

  @doc "Returns one stamp for a session: its partitions and its metadata."
  @spec session_stamp(Session.t(), %{String.t() => String.t()}) :: String.t()
  def session_stamp(%Session{} = session, stamps),
    do: CodeVersion.hash_term({Enum.sort(stamps), Enum.sort(session.metadata)})

  defp stamp_partition(%Partition{checksum: checksum}) when is_binary(checksum), do: checksum

  defp stamp_partition(%Partition{path: path}) do
    if StoredPath.address?(path), do: "address:" <> path, else: stamp_files(path)
  end

  defp stamp_files(path) do
    files = list_files(path)

    with true <- files != [] and Enum.sum(for {_, size, _} <- files, do: size) <= @most_bytes,
         {:ok, checksum} <- Checksum.compute(path) do
      checksum
    else
      _ -> "files:" <> CodeVersion.hash_term(files)
    end
  end

  defp list_files(path) do
    files =
      if File.dir?(path),
        do: path |> Path.join("*") |> Path.wildcard() |> Enum.sort(),
        else: [path]

    for file <- files,
        Path.extname(file) != ".lock",
        {:ok, %{type: :regular, size: size, mtime: time}} <- [File.stat(file, time: :posix)],
        do: {Path.basename(file), size, time}
  end
end
