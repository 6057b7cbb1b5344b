defmodule Situ.EditLog.DocumentFile do
  @moduledoc false
  # Reads and writes the file of a document, and notices that another program has changed it.
  alias Situ.EditLog.{Disk, Mark}
  alias Situ.Error

  @largest 64 * 1024 * 1024
  # File systems record the time of a change in seconds. A later change in the same second could have the same size.
  @uncertain_s 2

  @typedoc "The fields of a document that describe its file, see `t:Situ.EditLog.Document.t/0`."
  @type fields :: map()

  @doc """
  Reads a file with the module of its format. Returns the fields and the mark, in which `intact` is whether the digest
  fits. Errors: `:not_found`, `:bad_document`.
  """
  @spec read(Path.t(), module()) :: {:ok, fields(), map() | nil} | {:error, Error.t()}
  def read(path, format) do
    with {:ok, %{type: :regular, size: size}} when size <= @largest <- File.stat(path),
         {:ok, stat} <- Disk.file_stat(path),
         {:ok, text} <- File.read(path),
         {:ok, content, mark} <- format.parse(text, path) do
      fields = describe_file(text, stat)
      mark = mark && Map.put(mark, "intact", mark["digest"] == fields.digest)
      {:ok, Map.put(fields, :content, content), mark}
    else
      {:ok, %{type: :regular, size: size}} ->
        {:error, bad_document_error(path, "it has #{size} bytes; the limit is #{@largest}")}

      {:ok, %{type: type}} ->
        {:error, bad_document_error(path, "it is a #{type}")}

      {:error, why} when is_binary(why) ->
        {:error, bad_document_error(path, why)}

      {:error, reason} ->
        {:error,
         Error.new(:not_found, "cannot read #{path}",
           why: to_string(:file.format_error(reason)),
           fix: "check the path"
         )}
    end
  end

  defp describe_file(text, stat) do
    now = System.os_time(:second)
    %{stat: stat, checked: now, digest: Mark.text_digest(text), size: byte_size(text)}
  end

  defp bad_document_error(path, why), do: Error.new(:bad_document, "cannot use #{path}", why: why)

  @doc "Replaces the file and returns the fields. Error: `:not_saved`."
  @spec write(Path.t(), binary()) :: {:ok, fields()} | {:error, Error.t()}
  def write(path, text) do
    with :ok <- Disk.replace(path, text), {:ok, stat} <- Disk.file_stat(path) do
      {:ok, describe_file(text, stat)}
    else
      {:error, reason} ->
        {:error,
         Error.new(:not_saved, "cannot save #{path}",
           why: to_string(:file.format_error(reason)),
           fix: "the file was not changed; check the folder, or save to another file"
         )}
    end
  end

  @doc """
  Returns `:changed` if another program has changed the file since it was last read or written here, otherwise
  `{:unchanged, document}`. A deleted file counts as unchanged, because the next edit writes it again.
  """
  @spec check(document) :: {:unchanged, document} | :changed when document: map()
  def check(%{path: path, stat: stat} = document) do
    case Disk.file_stat(path) do
      {:ok, ^stat} -> check_uncertain(document)
      {:error, :enoent} -> {:unchanged, document}
      _ -> :changed
    end
  end

  # The text is compared once after a change that was too recent to be certain.
  defp check_uncertain(%{stat: {_, _, changed}, checked: checked} = document) do
    now = System.os_time(:second)

    cond do
      checked - changed >= @uncertain_s or now - changed < @uncertain_s -> {:unchanged, document}
      same_text?(document) -> {:unchanged, %{document | checked: now}}
      true -> :changed
    end
  end

  @doc "Returns whether the file has the text that was read or written last; also for a deleted file."
  @spec same_text?(map()) :: boolean()
  def same_text?(%{path: path, digest: digest}) do
    case File.read(path) do
      {:ok, text} -> Mark.text_digest(text) == digest
      {:error, _} -> true
    end
  end
end
