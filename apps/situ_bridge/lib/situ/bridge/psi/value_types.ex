defmodule Situ.Bridge.Psi.ValueTypes do
  @moduledoc false
  # Lists value types by name, for stores whose schemas are missing or do not distinguish structs from classes.

  @generic ~w(System.ValueTuple` System.Nullable` System.Collections.Generic.KeyValuePair` Microsoft.Psi.Message`)

  @structs MapSet.new(
             ~w(Microsoft.Psi.Audio.AudioBuffer Microsoft.Psi.Envelope MathNet.Spatial.Units.Angle
                System.DateTimeOffset) ++
               for(
                 name <-
                   ~w(Point2D Point3D Vector2D Vector3D UnitVector3D Quaternion EulerAngles Line3D
                            LineSegment2D LineSegment3D Ray3D Circle2D Circle3D),
                 do: "MathNet.Spatial.Euclidean." <> name
               ) ++
               for(
                 name <- ~w(Point PointF Size SizeF Rectangle RectangleF Color),
                 do: "System.Drawing." <> name
               ) ++
               for(
                 name <- ~w(Vector2 Vector3 Vector4 Quaternion Plane Complex Matrix3x2 Matrix4x4),
                 do: "System.Numerics." <> name
               )
           )

  @enums for name <- ~w(CompressionMethod DepthCompressionMethod PixelFormat DepthValueSemantics),
             do: "Microsoft.Psi.Imaging." <> name

  @doc "Returns whether the type with this name (without assemblies) is a struct."
  @spec struct_name?(String.t()) :: boolean()
  def struct_name?(name),
    do: String.starts_with?(name, @generic) or MapSet.member?(@structs, name)

  @doc "Returns the names of the 32-bit enums that images use."
  @spec enum_names() :: [String.t()]
  def enum_names, do: @enums
end
