defmodule Situ.Bridge.Mcap.NativeError do
  @moduledoc false
  # Converts failures of the native code to errors that users can act on.
  alias Situ.Error

  @spec wrap_result({:ok, value} | {:error, term()}, Path.t()) ::
          {:ok, value} | {:error, Error.t()}
        when value: term()
  def wrap_result({:ok, value}, _path), do: {:ok, value}
  def wrap_result({:error, reason}, path), do: {:error, to_error(reason, path)}

  @spec to_error(term(), Path.t()) :: Error.t()
  def to_error({:io, what, 28, _why}, path),
    do:
      Error.new(:disk_full, "the disk of #{path} is full",
        why: "could not #{what}",
        fix: "free some space, or write to another disk"
      )

  def to_error({:io, what, _errno, why}, path),
    do: Error.new(:io, "could not #{what} #{path}", why: why)

  def to_error(:not_mcap, path),
    do:
      Error.new(:not_mcap, "#{path} is not an MCAP file",
        why: "the file does not start with the MCAP magic bytes",
        fix: "check the path"
      )

  def to_error({:damaged, at, why}, path),
    do:
      Error.new(:damaged, "#{path} is damaged at byte #{at}",
        why: why,
        fix: "`situ store recover '#{path}' NEW.mcap` writes all readable data to a new file"
      )

  def to_error(:closed, path),
    do: Error.new(:closed, "#{path} is finished, so nothing more can be written to it")
end
