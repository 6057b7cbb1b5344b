defmodule Situ.Space.Native do
  @moduledoc false
  # Stubs of native/situ_space_nif. All functions run on dirty schedulers, and only Situ.Space.NativeCall calls them.

  @on_load :load

  @doc false
  def load do
    path = :filename.join([:code.priv_dir(:situ_space), "native", "situ_space_nif"])
    :erlang.load_nif(path, 0)
  end

  def ray_table(_camera, _undistort), do: :erlang.nif_error(:not_loaded)
  def depth_cloud(_depth, _table, _sparsity, _robust, _colors), do: :erlang.nif_error(:not_loaded)
  def depth_mesh(_depth, _table, _edge, _sparsity), do: :erlang.nif_error(:not_loaded)
  def depth_colors(_depth, _table, _picture), do: :erlang.nif_error(:not_loaded)
  def las_unpack(_file, _records, _packing), do: :erlang.nif_error(:not_loaded)

  def las_points(_records, _size, _colors, _scale, _offset),
    do: :erlang.nif_error(:not_loaded)

  def record_floats(_records, _row, _fields, _big), do: :erlang.nif_error(:not_loaded)
  def record_tones(_records, _row, _fields, _big), do: :erlang.nif_error(:not_loaded)
  def downsample(_points, _size), do: :erlang.nif_error(:not_loaded)
  def thin(_records, _size, _most), do: :erlang.nif_error(:not_loaded)
  def within(_points, _colors, _values, _planes, _most), do: :erlang.nif_error(:not_loaded)
  def clusters(_points, _radius, _least), do: :erlang.nif_error(:not_loaded)
  def clip(_points, _min, _max), do: :erlang.nif_error(:not_loaded)
  def transform(_points, _rotation, _position), do: :erlang.nif_error(:not_loaded)
  def plane(_points, _tolerance, _rounds, _seed), do: :erlang.nif_error(:not_loaded)
  def normals(_points, _radius, _viewpoint), do: :erlang.nif_error(:not_loaded)
  def render(_shapes, _position, _rotation, _table, _scale), do: :erlang.nif_error(:not_loaded)
end
