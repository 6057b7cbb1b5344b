defmodule Situ.Media.Native do
  @moduledoc false
  # Stubs of native/situ_media_nif. `run` and `run_sound` stay on the calling scheduler and charge their time to the
  # process, while `*_dirty` run on a dirty CPU scheduler. Situ.Media.NativeKernel chooses between them.

  @on_load :load

  @doc false
  def load do
    path = :filename.join([:code.priv_dir(:situ_media), "native", "situ_media_nif"])
    :erlang.load_nif(path, 0)
  end

  def run(_job), do: :erlang.nif_error(:not_loaded)
  def run_dirty(_job), do: :erlang.nif_error(:not_loaded)
  def run_sound(_job), do: :erlang.nif_error(:not_loaded)
  def run_sound_dirty(_job), do: :erlang.nif_error(:not_loaded)
end
