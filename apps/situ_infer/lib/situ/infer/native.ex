defmodule Situ.Infer.Native do
  @moduledoc false
  # Stubs of the native functions. Their callers, `Situ.Infer.Engine.Ort` and `Situ.Infer.Patch`, check the arguments.
  @on_load :load

  def load do
    path = :filename.join([:code.priv_dir(:situ_infer), ~c"native", ~c"situ_infer_nif"])
    :erlang.load_nif(path, 0)
  end

  def load_runtime(_path), do: :erlang.nif_error(:nif_not_loaded)
  def runtime_version, do: :erlang.nif_error(:nif_not_loaded)

  def load_model(_bytes, _threads, _sessions, _device, _folder),
    do: :erlang.nif_error(:nif_not_loaded)

  def run_dirty(_model, _inputs), do: :erlang.nif_error(:nif_not_loaded)
  def run_inline(_model, _inputs), do: :erlang.nif_error(:nif_not_loaded)

  def cut_patch(_data, _size, _matrix, _patch, _range),
    do: :erlang.nif_error(:nif_not_loaded)
end
