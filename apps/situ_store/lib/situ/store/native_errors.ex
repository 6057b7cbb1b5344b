defmodule Situ.Store.NativeErrors do
  @moduledoc false
  # Converts the failures of native code to errors that people can act on.
  alias Situ.Error

  @spec to_error(term(), Path.t(), String.t() | nil) :: Error.t()
  def to_error(reason, path, stream \\ nil)

  # The data could not be fetched (`Situ.Store.S3.Mirror`).
  def to_error(%Error{} = error, _path, _stream), do: error

  def to_error({:io, what, 28, _why}, path, _stream) do
    Error.new(:disk_full, "no space left on the disk of #{path}",
      why: "could not #{what}; all data written before is safe and readable",
      fix: "free some space, or record to another disk"
    )
  end

  def to_error({:io, what, errno, why}, path, _stream) when errno in [1, 13, 30] do
    Error.new(:not_permitted, "not permitted to #{what} in #{path}",
      why: why,
      fix: "check the folder's owner and permissions"
    )
  end

  # ENOLCK, ENOSYS and EOPNOTSUPP.
  def to_error({:io, "lock", errno, why}, path, _stream) when errno in [37, 38, 95] do
    Error.new(:no_locks, "cannot lock #{path}: its file system has no working locks",
      why: why,
      fix: "use a local disk, or mount the file system with locks"
    )
  end

  def to_error({:io, what, _errno, why}, path, _stream) do
    Error.new(:io, "could not #{what} in #{path}", why: why)
  end

  def to_error(:locked, path, _stream) do
    Error.new(:store_in_use, "the store #{path} is being written to",
      why: "another writer holds its lock",
      fix: "stop that pipeline first, or record to another name"
    )
  end

  def to_error(:no_store, path, _stream) do
    Error.new(:no_store, "no store at #{path}",
      fix: "check the path; `situ store info FOLDER` lists the stores in a folder"
    )
  end

  def to_error(:compaction_interrupted, path, _stream) do
    Error.new(:compaction_interrupted, "the store #{path} has lost its name",
      why: "a compaction was killed while it replaced the store; no data is lost",
      fix: "`situ store repair '#{path}'` restores the name"
    )
  end

  def to_error(:index_lost, path, _stream) do
    Error.new(:index_lost, "the store #{path} has lost its index",
      why: "there is no index.situ in it",
      fix: "restore the file, or rebuild it from the data with `situ store repair`"
    )
  end

  def to_error(:not_a_store, path, _stream) do
    Error.new(:not_a_store, "#{path} is not a store",
      why: "its index does not have the format of a store",
      fix: "if it was a store, `situ store repair` rebuilds a lost index from the data"
    )
  end

  def to_error({:newer_version, version}, path, _stream) do
    Error.new(:newer_version, "the store #{path} has format version #{version}",
      why: "this release of Situ reads versions up to 2",
      fix: "read it with a newer release"
    )
  end

  def to_error({:not_increasing, _id, last, got}, path, stream) do
    Error.new(:not_increasing, "originating times of stream #{inspect(stream)} must increase",
      why: "after #{Situ.Time.to_iso8601(last)} came #{Situ.Time.to_iso8601(got)}",
      fix: "give every message a later originating time than the previous message of its stream",
      meta: %{path: path, last: last, got: got}
    )
  end

  def to_error({:not_storable, what}, path, stream) do
    Error.new(:not_storable, "a message of stream #{inspect(stream)} contains #{what}",
      why: "this value has no meaning in another process or after a restart",
      fix: "map the stream to plain data before writing it",
      meta: %{path: path}
    )
  end

  def to_error({:too_large, size}, _path, stream) do
    Error.new(:too_large, "a message of stream #{inspect(stream)} has #{size} bytes",
      why: "the limit is 1 GiB per message",
      fix: "split the message"
    )
  end

  def to_error(:deleted, path, _stream) do
    Error.new(:store_deleted, "the folder #{path} was deleted while it was being written",
      fix: "record again"
    )
  end

  def to_error(:closed, path, _stream), do: Error.new(:closed, "the store #{path} is closed")

  def to_error(:stream_exists, path, stream) do
    Error.new(:stream_exists, "the store #{path} already has a stream #{inspect(stream)}",
      fix: "write each stream only once and under a unique name"
    )
  end

  def to_error({:damaged, file, offset, why}, path, stream) do
    Error.new(:damaged, "the store #{path} is damaged in #{file} at byte #{offset}",
      why: why,
      fix: "`situ store verify` lists all damage, `situ store repair` drops the damaged data",
      meta: %{file: file, offset: offset, stream: stream}
    )
  end

  def to_error({:missing_extent, file}, path, stream) do
    Error.new(:missing_extent, "the store #{path} has lost its file #{file}",
      why: "the file contained part of its messages",
      fix: "restore the file, or continue without it using `situ store repair`",
      meta: %{file: file, stream: stream}
    )
  end

  def to_error(other, path, stream) do
    Error.new(:store_failed, "the store #{path} failed: #{inspect(other)}",
      meta: %{stream: stream}
    )
  end

  @doc "Returns the error for a missing stream, with a suggestion from `names`."
  @spec no_stream_error(String.t(), [String.t()], Path.t()) :: Error.t()
  def no_stream_error(name, names, path) do
    fix =
      case Situ.Options.nearest_name(name, names) do
        nil -> list_names(names)
        near -> "did you mean #{inspect(near)}?"
      end

    Error.new(:no_stream, "no stream #{inspect(name)} in #{path}", fix: fix)
  end

  @shown 12

  defp list_names([]), do: "it has no streams"

  defp list_names(names) do
    more = length(names) - @shown

    "streams: " <>
      Enum.map_join(Enum.take(names, @shown), ", ", & &1) <>
      if(more > 0, do: " and #{more} more (`situ store info` lists them)", else: "")
  end

  @spec wrap_error(ok | {:error, term()}, Path.t(), String.t() | nil) :: ok | {:error, Error.t()}
        when ok: tuple()
  def wrap_error(result, path, stream \\ nil)
  def wrap_error({:error, reason}, path, stream), do: {:error, to_error(reason, path, stream)}
  def wrap_error(ok, _path, _stream), do: ok
end
