defmodule Situ.Media.OpenCV do
  @moduledoc false
  # Stubs of native/situ_opencv_nif, the kernels that need Debian's libopencv. It is a separate library, so that a
  # machine without OpenCV loses only these kernels.
  # See docs/adr/0041-opencv-is-a-separate-library.md.

  @on_load :load

  @doc false
  def load do
    path = :filename.join([:code.priv_dir(:situ_media), "native", "situ_opencv_nif"])

    # Without the library the module still loads, and its functions raise :not_loaded.
    case :erlang.load_nif(path, 0) do
      :ok -> :ok
      {:error, {:load_failed, _}} -> :ok
      {:error, _} = error -> error
    end
  end

  def run(_job), do: :erlang.nif_error(:not_loaded)
  def run_dirty(_job), do: :erlang.nif_error(:not_loaded)
end
